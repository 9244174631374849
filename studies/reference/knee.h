/* A knee of the reference: an ellipse on an inclined plane under a contact law; what one tick prescribes; a contact's mode.

   SI throughout. Within a tick the femur's height is counted from where it stood when the tick began, and the depth from
   its value there: small differences, so that 64 bits of mantissa lose nothing on the way. */
#ifndef KNEE_H
#define KNEE_H

#include <math.h>

typedef long double real;

#define MOST_TERMS 40
#define EPSILON 5.4e-20L /* of a number */

typedef struct {
    real begin;     /* depth at which the layer begins */
    real base;      /* force of the layers above, there */
    real stiffness; /* K of K w^n, w = depth - begin */
    real exponent;  /* n */
    real damping;   /* C */
} Layer;

typedef struct {
    int layers;
    Layer layer[2];
    real loss;        /* D of the laws that remember the impact, else 0 */
    real least_speed; /* floor under the impact speed */
    int tension;      /* whether the contact may pull */
    real mass;
    real aa, bb;      /* squared half axes: anterior, superior */
    real slope, cosine;
} Knee;

typedef struct {
    real duration;
    real phi, turn;        /* angle less slope where the tick begins, and its rate */
    real load, load_rate;
    real depth;            /* where the tick begins */
    real support;          /* the ellipse's, there */
} Tick;

enum { APART = -1 };
enum { NOWHERE, ABOVE, BELOW, SIGN }; /* boundaries of a mode: layer's upper and lower end, the force's change of sign */

typedef struct {
    int layer;
    int pressing; /* whether the contact exerts its force; else it is released, or apart */
    real impact;  /* penetration rate at first touch, 0 if the contact began at rest */
    int on;       /* the boundary on which the mode has just begun */
} Mode;

/* w^n, odd in w, so that it goes on smoothly enough across the boundary at 0; and its slope. */
static inline real power(real w, real n, real *slope) {
    real a = fabsl(w), lower; /* lower: |w|^(n-1) */
    if (n == 1.0L) lower = 1.0L;
    else if (n == 1.5L) lower = sqrtl(a);
    else if (n == 2.0L) lower = a;
    else if (n == 2.5L) lower = a * sqrtl(a);
    else if (n == 3.0L) lower = a * a;
    else lower = a > 0.0L ? powl(a, n - 1.0L) : 0.0L;
    *slope = n * lower;
    return lower * w;
}

static inline real loss_over_speed(const Knee *k, const Mode *m) {
    return k->loss > 0.0L ? k->loss / fmaxl(m->impact, k->least_speed) : 0.0L;
}

/* The layer's formula, and its slopes over depth and rate. */
static inline real formula(const Knee *k, const Mode *m, real depth, real rate, real *stiffness, real *damping) {
    const Layer *layer = &k->layer[m->layer];
    real slope, p = power(depth - layer->begin, layer->exponent, &slope);
    real elastic = layer->stiffness * p, steep = layer->stiffness * slope;
    if (k->loss > 0.0L) {
        real d = loss_over_speed(k, m), factor = 1.0L + d * rate;
        *stiffness = steep * factor;
        *damping = elastic * d;
        return elastic * factor;
    }
    *stiffness = steep;
    *damping = layer->damping;
    return layer->base + elastic + layer->damping * rate;
}

/* What changes its sign with the force, without the factor that vanishes at first touch. */
static inline real sign_value(const Knee *k, const Mode *m, real depth, real rate) {
    real stiffness, damping;
    if (k->loss > 0.0L) return 1.0L + loss_over_speed(k, m) * rate;
    return formula(k, m, depth, rate, &stiffness, &damping);
}

/* Whether the formula may become negative where the surfaces overlap. */
static inline int may_pull(const Knee *k, const Mode *m) {
    return m->layer >= 0 && !k->tension && (k->loss > 0.0L || k->layer[m->layer].damping > 0.0L);
}

/* Support of the ellipse at an angle. */
static inline real support(const Knee *k, real phi) {
    real s = sinl(phi), c = cosl(phi);
    return sqrtl(k->aa * s * s + k->bb * c * c);
}

/* How far the support has grown since the tick began, and how fast it grows. */
static inline real grown(const Knee *k, const Tick *t, real s, real *rate) {
    real d = k->aa - k->bb;
    *rate = 0.0L;
    if (d == 0.0L || t->turn == 0.0L) return 0.0L;
    real turned = t->turn * s, phi = t->phi + turned, sine = sinl(phi), cosine = cosl(phi);
    real h = sqrtl(k->aa * sine * sine + k->bb * cosine * cosine);
    *rate = d * sine * cosine / h * t->turn;
    return d * sinl(turned) * sinl(t->phi + phi) / (h + t->support);
}

#endif
