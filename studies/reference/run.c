/* The reference solution: from tick to tick, from event to event. */
#include "radau.h"
#include "run.h"
#include "series.h"

#define MOST_IDLE 50 /* events in a row without any time between them */

/* All that one tick hands to the next; Python keeps it as so many bytes. */
typedef struct {
    real depth, velocity, angle, load;
    real implicit_duration; /* what an implicit step should try */
    real first_duration;    /* the same for the first step behind a boundary, where the force has no series */
    Mode mode;
    int begun, moving, failed;
} State;

unsigned long state_size(void) { return sizeof(State); }

/* A tick on its way. */
typedef struct {
    real s, height, velocity;
    Mode mode;
    real implicit_duration, first_duration;
    double cost;
    int idle;
} StepperState;

typedef struct {
    const Knee *knee;
    const Tick *tick;
    const Accuracy *accuracy;
} Problem;

static Knee knee_of(const Constants *c) {
    Knee k;
    real slope;
    k.layers = c->layer_depth >= 0.0 ? 2 : 1;
    for (int i = 0; i < k.layers; i++)
        k.layer[i] = (Layer){i ? c->layer_depth : 0.0L, 0.0L, c->stiffness[i], c->exponent[i], c->damping[i]};
    if (k.layers == 2) k.layer[1].base = k.layer[0].stiffness * power(c->layer_depth, c->exponent[0], &slope);
    k.loss = c->loss;
    k.least_speed = c->least_speed;
    k.tension = c->tension;
    k.mass = c->mass;
    k.aa = (real)c->a * (real)c->a;
    k.bb = (real)c->b * (real)c->b;
    k.slope = c->slope;
    k.cosine = cosl(c->slope);
    return k;
}

static real static_depth(const Knee *k, real force) {
    if (force <= 0.0L) return 0.0L;
    const Layer *layer = &k->layer[k->layers == 2 && k->layer[1].base < force];
    return layer->begin + powl((force - layer->base) / layer->stiffness, 1.0L / layer->exponent);
}

static void contact_at(const Problem *p, const StepperState *g, real *depth, real *rate) {
    real growth_rate, growth = grown(p->knee, p->tick, g->s, &growth_rate);
    *depth = p->tick->depth + growth - p->knee->cosine * g->height;
    *rate = growth_rate - p->knee->cosine * g->velocity;
}

static int presses(const Knee *k, const Mode *m, real depth, real rate) {
    return m->layer >= 0 && (k->tension || !may_pull(k, m) || sign_value(k, m, depth, rate) >= 0.0L);
}

/* Go on behind a boundary of the mode. */
static void switch_mode(const Problem *p, StepperState *g, int boundary) {
    real depth, rate;
    Mode *m = &g->mode;
    contact_at(p, g, &depth, &rate);
    if (boundary == SIGN) {
        m->pressing = !m->pressing;
    } else {
        if (m->layer == APART) m->impact = fmaxl(rate, 0.0L);
        m->layer += boundary == BELOW ? 1 : -1;
        if (m->layer >= 0) depth = boundary == BELOW ? p->knee->layer[m->layer].begin : p->knee->layer[m->layer + 1].begin;
        m->pressing = presses(p->knee, m, depth, rate);
    }
    m->on = boundary == SIGN ? SIGN : boundary == BELOW ? ABOVE : BELOW;
    g->implicit_duration = m->on == ABOVE ? fminl(g->first_duration, p->tick->duration) : p->tick->duration;
}

/* Take one explicit step by series; 0 if an implicit one would be quicker. */
static int series_step(const Problem *p, StepperState *g) {
    Series series;
    real left = p->tick->duration - g->s, when;
    develop(p->knee, p->tick, &g->mode, g->s, g->height, g->velocity, p->accuracy->degree, &series);
    g->cost += p->accuracy->degree;
    real h = reach(p->knee, &g->mode, &series, p->accuracy->tolerance, p->accuracy->force_tolerance);
    int gains = series.singular || p->accuracy->implicit || (series.stiff && h < 0.1L * fminl(g->implicit_duration, left));
    if (g->mode.pressing && gains && (h < left || p->accuracy->implicit)) return 0;
    int last = h >= left;
    h = fminl(h, left);
    int boundary = first_crossing(p->knee, &g->mode, &series, h, &when);
    g->height = value_of(series.height, series.degree, when);
    g->velocity = slope_of(series.height, series.degree, when);
    g->idle = g->s + when > g->s ? 0 : g->idle + 1;
    g->s = last && boundary == NOWHERE ? p->tick->duration : g->s + when;
    if (series.stiff) g->implicit_duration *= 1.15L;
    g->mode.on = NOWHERE;
    if (boundary != NOWHERE) switch_mode(p, g, boundary);
    return 1;
}

/* How far a contact lies inside a boundary of the mode: negative beyond it. */
static real inside(const Problem *p, const Mode *m, int boundary, real depth, real rate) {
    if (boundary == ABOVE) return depth - p->knee->layer[m->layer].begin;
    if (boundary == BELOW) return p->knee->layer[m->layer + 1].begin - depth;
    return sign_value(p->knee, m, depth, rate);
}

/* What counts as on a boundary. */
static real rounding(const Problem *p, const Mode *m, int boundary) {
    if (boundary != SIGN) return 1e-20L;
    return p->knee->loss > 0.0L ? 1e-15L : 1e-15L * fmaxl(1.0L, fabsl(p->tick->load) + p->knee->layer[m->layer].base);
}

/* First stage of a step that lies beyond a boundary: its number, or STAGES. */
static int first_beyond(const Problem *p, const Mode *m, const Implicit *step, int *boundary) {
    for (int i = 0; i < STAGES; i++) {
        for (int b = ABOVE; b <= SIGN; b++) {
            if (b == BELOW && m->layer + 1 >= p->knee->layers) continue;
            if (b == SIGN && !may_pull(p->knee, m)) continue;
            if (inside(p, m, b, step->depth[i], step->rate[i]) < -rounding(p, m, b)) {
                *boundary = b;
                return i;
            }
        }
    }
    *boundary = NOWHERE;
    return STAGES;
}

/* Two steps of half the duration. */
typedef struct {
    Implicit half[2];
    int solved;
} Pair;

static Pair pair_step(const Problem *p, StepperState *g, real h) {
    Pair pair;
    real middle = 0.5L * h;
    pair.half[0] = implicit_step(p->knee, p->tick, &g->mode, g->s, g->height, g->velocity, middle);
    const Implicit *first = &pair.half[0];
    g->cost += STAGES * first->iterations;
    pair.solved = first->solved;
    if (!pair.solved) return pair;
    pair.half[1] = implicit_step(p->knee, p->tick, &g->mode, g->s + middle, first->height, first->velocity, middle);
    g->cost += STAGES * pair.half[1].iterations;
    pair.solved = pair.half[1].solved;
    return pair;
}

/* When the first stage of a pair that lies beyond a boundary does so: a fraction of the whole, 2 if none does. */
static real beyond_at(const Problem *p, const Mode *m, const Pair *pair, int *boundary) {
    for (int half = 0; half < 2; half++) {
        int stage = first_beyond(p, m, &pair->half[half], boundary);
        if (stage < STAGES) return 0.5L * ((real)half + NODES[stage]);
    }
    return 2.0L;
}

static void take(const Problem *p, StepperState *g, const Implicit *end, real h) {
    real left = p->tick->duration - g->s;
    g->idle = g->s + h > g->s ? 0 : g->idle + 1;
    g->s = h >= left ? p->tick->duration : g->s + h;
    g->height = end->height;
    g->velocity = end->velocity;
    g->mode.on = NOWHERE;
}

/* End a step on a boundary that a stage at `high` lies beyond. Returns 0 if there is nothing to end on yet: `high` is
   then what to try instead. */
static int end_on(const Problem *p, StepperState *g, int boundary, real *high) {
    Mode *m = &g->mode;
    real low = 0.0L, at_low, at_high, depth, rate, last = 0.0L, enough = rounding(p, m, boundary);
    Pair pair = pair_step(p, g, *high);
    const Implicit *end = &pair.half[1];
    if (!pair.solved) return *high *= 0.25L, 0;
    at_high = inside(p, m, boundary, end->depth[STAGES - 1], end->rate[STAGES - 1]);
    if (at_high >= 0.0L) return *high *= 0.5L, 0;
    contact_at(p, g, &depth, &rate);
    at_low = m->on == boundary ? 0.0L : inside(p, m, boundary, depth, rate);
    if (at_low <= enough) { /* it begins here: a shorter step may lead inside first */
        if (g->s + 1e-3L * *high > g->s && *high > 1e-13L * p->tick->duration) return *high *= 0.1L, 0;
        g->idle++;
        switch_mode(p, g, boundary);
        return 1;
    }
    real h = *high;
    for (int i = 0; i < 100; i++) {
        h = low + (*high - low) * at_low / (at_low - at_high);
        if (!(h > low && h < *high)) break;
        pair = pair_step(p, g, h);
        if (!pair.solved) return *high = 0.5L * h, 0;
        real v = inside(p, m, boundary, end->depth[STAGES - 1], end->rate[STAGES - 1]);
        if (fabsl(v) <= 0.1L * enough) break;
        int again = v * last > 0.0L;
        if (v < 0.0L) {
            *high = h;
            at_high = v;
            if (again) at_low *= 0.5L;
        } else {
            low = h;
            at_low = v;
            if (again) at_high *= 0.5L;
        }
        last = v;
    }
    int other;
    real earlier = beyond_at(p, m, &pair, &other);
    if (earlier <= 1.0L && other != boundary) return *high = earlier * h, 0;
    take(p, g, end, h);
    switch_mode(p, g, boundary);
    return 1;
}

/* Part of the tolerance that the difference of two solutions of a step takes. */
static real share(const Problem *p, const StepperState *g, const Implicit *one, const Implicit *two, real h) {
    const Knee *k = p->knee;
    real stiffness, damping, cc = k->cosine * k->cosine;
    real depth = two->depth[STAGES - 1], rate = two->rate[STAGES - 1];
    real noise = 8.0L * EPSILON * fabsl(formula(k, &g->mode, depth, rate, &stiffness, &damping));
    real high = fabsl(one->height - two->height), fast = fabsl(one->velocity - two->velocity);
    real swift = fmaxl(1.0L, cc * damping / k->mass);
    real tolerance = p->accuracy->tolerance, force_tolerance = p->accuracy->force_tolerance;
    real rounding_speed = 8.0L * EPSILON * fabsl(two->velocity) + noise / (cc * damping + k->mass / h);
    real rounding_height = 8.0L * EPSILON * (fabsl(two->height) + fabsl(depth)) + h * rounding_speed;
    real worst = high / (fmaxl(tolerance * fminl(1.0L, 100.0L * h), 1e-21L) + rounding_height);
    worst = fmaxl(worst, fast / (tolerance * swift + rounding_speed));
    real force = stiffness * high + damping * fast;
    worst = fmaxl(worst, force / (force_tolerance + noise + stiffness * rounding_height + damping * rounding_speed));
    return worst / 15.0L; /* the pair's error is far below the difference */
}

/* Take one implicit step. */
static void radau_step(const Problem *p, StepperState *g) {
    real left = p->tick->duration - g->s, h = fminl(g->implicit_duration, left);
    int first = g->mode.on == ABOVE;
    for (;;) {
        if (!(g->s + h > g->s) || g->cost > p->accuracy->most_cost) {
            g->cost = INFINITY;
            return;
        }
        Implicit one = implicit_step(p->knee, p->tick, &g->mode, g->s, g->height, g->velocity, h);
        g->cost += STAGES * one.iterations;
        if (!one.solved) {
            h *= 0.2L;
            continue;
        }
        Pair pair = pair_step(p, g, h);
        if (!pair.solved) {
            h *= 0.2L;
            continue;
        }
        int boundary;
        real beyond = beyond_at(p, &g->mode, &pair, &boundary);
        real used = share(p, g, &one, &pair.half[1], h);
        if (!(used <= 1.0L)) {
            real factor = 0.8L * powl(used, -1.0L / 8.0L);
            h *= factor > 0.1L ? factor : 0.1L;
            g->implicit_duration = h;
            continue;
        }
        if (first) g->first_duration = 1.2L * h;
        if (boundary == NOWHERE) {
            real factor = 0.8L * powl(fmaxl(used, 1e-12L), -1.0L / 10.0L);
            if (h < left || factor < 1.0L) g->implicit_duration = h * fminl(fmaxl(factor, 0.5L), 5.0L);
            else g->implicit_duration = fmaxl(g->implicit_duration, h * fminl(factor, 5.0L));
            take(p, g, &pair.half[1], h);
            return;
        }
        h *= beyond;
        if (end_on(p, g, boundary, &h)) return;
    }
}

/* Carry the femur over a tick; 0 if it costs too much. */
static int advance(const Problem *p, StepperState *g) {
    real depth, rate;
    contact_at(p, g, &depth, &rate);
    g->mode.pressing = presses(p->knee, &g->mode, depth, rate); /* the angle's rate has jumped, and so has the force */
    if (g->mode.on == SIGN) g->mode.on = NOWHERE;
    while (g->s < p->tick->duration) {
        if (g->cost > p->accuracy->most_cost || g->idle > MOST_IDLE) return 0;
        if (!series_step(p, g)) radau_step(p, g);
    }
    return isfinite(g->height) && isfinite(g->velocity);
}

static void write(const Knee *k, const State *state, real phi, real rate, double *depth, double *speed, double *force,
                  double *height) {
    real stiffness, damping, pushed = 0.0L;
    if (state->mode.pressing) pushed = formula(k, &state->mode, state->depth, rate, &stiffness, &damping);
    if (!k->tension) pushed = fmaxl(pushed, 0.0L);
    *depth = (double)state->depth;
    *speed = (double)rate;
    *force = (double)pushed;
    *height = (double)((support(k, phi) - state->depth) / k->cosine);
}

static void start(const Knee *k, State *state, real angle, real load) {
    state->depth = static_depth(k, load / k->cosine);
    state->begun = 1;
    state->angle = angle;
    state->load = load;
    int layer = k->layers == 2 && state->depth > k->layer[1].begin ? 1 : 0;
    /* without load it just touches: apart, and about to touch if it is pressed or turns its longer side down */
    state->mode = (Mode){state->depth > 0.0L ? layer : APART, state->depth > 0.0L, 0.0L, state->depth > 0.0L ? NOWHERE : BELOW};
    state->implicit_duration = state->first_duration = 1.0L;
}

static int step(const Knee *k, State *state, const Accuracy *accuracy, real duration, real angle, real load, real *rate) {
    Tick tick = {duration, state->angle - k->slope, (angle - state->angle) / duration, state->load,
                 (load - state->load) / duration, state->depth, 0.0L};
    tick.support = support(k, tick.phi);
    Problem problem = {k, &tick, accuracy};
    StepperState stepper = {0.0L, 0.0L, state->velocity, state->mode, state->implicit_duration, state->first_duration, 0.0, 0};
    if (!state->moving) { /* it follows its turning surface */
        real growth_rate;
        grown(k, &tick, 0.0L, &growth_rate);
        stepper.velocity = growth_rate / k->cosine;
        state->moving = 1;
    }
    if (!advance(&problem, &stepper)) return 0;
    contact_at(&problem, &stepper, &state->depth, rate);
    state->velocity = stepper.velocity;
    state->mode = stepper.mode;
    state->implicit_duration = fminl(fmaxl(stepper.implicit_duration, 1e-3L * duration), 1.0L);
    state->first_duration = stepper.first_duration;
    state->angle = angle;
    state->load = load;
    return 1;
}

/* Take `count` ticks from a state (all zeros: none yet; the first tick's duration does not count). Ticks that were not
   solved, and all behind them, are NaN. Returns how many were solved. */
long run(const Constants *constants, const Accuracy *accuracy, State *state, long count, const double *duration,
         const double *angle, const double *load, double *depth, double *rate, double *force, double *height) {
    Knee knee = knee_of(constants);
    for (long i = 0; i < count; i++) {
        real speed = 0.0L;
        if (!state->begun) start(&knee, state, angle[i], load[i]);
        else if (!state->failed) state->failed = !step(&knee, state, accuracy, duration[i], angle[i], load[i], &speed);
        if (state->failed) {
            for (long j = i; j < count; j++) depth[j] = rate[j] = force[j] = height[j] = NAN;
            return i;
        }
        write(&knee, state, (real)angle[i] - knee.slope, speed, &depth[i], &rate[i], &force[i], &height[i]);
    }
    return count;
}
