#include "radau.h"

/* Solve matrix x = right in place, with pivots. */
static int eliminate(real matrix[STAGES][STAGES], real *right) {
    for (int i = 0; i < STAGES; i++) {
        int pivot = i;
        for (int row = i + 1; row < STAGES; row++)
            if (fabsl(matrix[row][i]) > fabsl(matrix[pivot][i])) pivot = row;
        if (!(fabsl(matrix[pivot][i]) > 0.0L)) return 0;
        if (pivot != i) {
            for (int j = i; j < STAGES; j++) {
                real keep = matrix[i][j];
                matrix[i][j] = matrix[pivot][j];
                matrix[pivot][j] = keep;
            }
            real keep = right[i];
            right[i] = right[pivot];
            right[pivot] = keep;
        }
        for (int row = i + 1; row < STAGES; row++) {
            real factor = matrix[row][i] / matrix[i][i];
            for (int j = i + 1; j < STAGES; j++) matrix[row][j] -= factor * matrix[i][j];
            right[row] -= factor * right[i];
        }
    }
    for (int i = STAGES - 1; i >= 0; i--) {
        for (int j = i + 1; j < STAGES; j++) right[i] -= matrix[i][j] * right[j];
        right[i] /= matrix[i][i];
    }
    return 1;
}

/* Unknown are the velocities' changes g at the stages: mass A^-1 g / duration = cosine force - load there. */
Implicit implicit_step(const Knee *k, const Tick *t, const Mode *m, real s, real height, real velocity, real duration) {
    Implicit step;
    real growth[STAGES], growth_rate[STAGES], load[STAGES], g[STAGES] = {0}, risen[STAGES];
    real inertia = k->mass / duration, last = INFINITY;
    for (int i = 0; i < STAGES; i++) {
        real at = s + NODES[i] * duration;
        growth[i] = grown(k, t, at, &growth_rate[i]);
        load[i] = t->load + t->load_rate * at;
    }
    step.solved = 0;
    for (step.iterations = 1; step.iterations <= 40; step.iterations++) {
        real matrix[STAGES][STAGES], right[STAGES], largest = 0.0L, size = fabsl(velocity), noise = 0.0L;
        for (int i = 0; i < STAGES; i++) {
            real sum = 0.0L, stiffness, damping;
            risen[i] = NODES[i] * velocity;
            for (int j = 0; j < STAGES; j++) {
                risen[i] += RADAU[i][j] * g[j];
                sum += RADAU_INVERSE[i][j] * g[j];
            }
            risen[i] *= duration;
            step.depth[i] = t->depth + growth[i] - k->cosine * (height + risen[i]);
            step.rate[i] = growth_rate[i] - k->cosine * (velocity + g[i]);
            real force = formula(k, m, step.depth[i], step.rate[i], &stiffness, &damping);
            real cc = k->cosine * k->cosine;
            right[i] = k->cosine * force - load[i] - inertia * sum;
            for (int j = 0; j < STAGES; j++)
                matrix[i][j] = inertia * RADAU_INVERSE[i][j] + cc * fmaxl(stiffness, 0.0L) * duration * RADAU[i][j];
            matrix[i][i] += cc * fmaxl(damping, 0.0L);
            noise = fmaxl(noise, EPSILON * (fabsl(force) + fabsl(load[i])) / matrix[i][i]);
        }
        if (!eliminate(matrix, right)) return step;
        for (int i = 0; i < STAGES; i++) {
            g[i] += right[i];
            largest = fmaxl(largest, fabsl(right[i]));
            size = fmaxl(size, fabsl(velocity + g[i]));
        }
        real sum = 0.0L;
        for (int i = 0; i < STAGES; i++) sum += fabsl(g[i]);
        if (!(sum < INFINITY)) return step; /* nor a NaN, which fmaxl would swallow */
        int arrived = largest <= 1e-18L * size + 20.0L * noise + 1e-30L;
        int stagnant = largest <= 1e-13L * size && largest >= 0.5L * last;
        if (arrived || stagnant) {
            step.solved = 1;
            break;
        }
        last = largest;
    }
    for (int i = 0; i < STAGES; i++) {
        real up = NODES[i] * velocity;
        for (int j = 0; j < STAGES; j++) up += RADAU[i][j] * g[j];
        risen[i] = up * duration;
        step.depth[i] = t->depth + growth[i] - k->cosine * (height + risen[i]);
        step.rate[i] = growth_rate[i] - k->cosine * (velocity + g[i]);
    }
    step.height = height + risen[STAGES - 1];
    step.velocity = velocity + g[STAGES - 1];
    return step;
}
