/* The motion as a power series in time: an explicit step of any order whose events are zeros of polynomials. */
#ifndef SERIES_H
#define SERIES_H

#include "knee.h"

typedef struct {
    int degree;
    real height[MOST_TERMS + 1]; /* since the tick began; its derivative is the velocity */
    real depth[MOST_TERMS + 1];
    real force[MOST_TERMS + 1];  /* of the layer's formula, whether exerted or not; of degree - 2 */
    real value[MOST_TERMS + 1];  /* what changes its sign with the force; of degree - 2 */
    int singular;                /* the force has no series here: a power that is not whole, at 0 */
    int stiff;                   /* what limits the duration is stability, and not the accuracy */
} Series;

/* Develop the motion about time s of a tick, from a height (since it began) and a velocity. */
void develop(const Knee *, const Tick *, const Mode *, real s, real height, real velocity, int degree, Series *);

/* Duration that a series may be followed for; force_tolerance is that of the force. */
real reach(const Knee *, const Mode *, Series *, real tolerance, real force_tolerance);

/* First boundary of the mode that the series crosses within a duration, and when; NOWHERE if none. */
int first_crossing(const Knee *, const Mode *, const Series *, real duration, real *when);

real value_of(const real *coefficients, int degree, real t);
real slope_of(const real *coefficients, int degree, real t);

#endif
