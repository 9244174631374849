/* Implicit steps by Radau's method: for stiff contacts, and where the force has no power series. */
#ifndef RADAU_H
#define RADAU_H

#include "knee.h"
#include "radau_table.h"

typedef struct {
    real height, velocity;                /* at its end; the height since the tick began */
    real depth[STAGES], rate[STAGES];     /* at its stages, the last of which is the end */
    int iterations;
    int solved;
} Implicit;

/* One step from time s of a tick. */
Implicit implicit_step(const Knee *, const Tick *, const Mode *, real s, real height, real velocity, real duration);

#endif
