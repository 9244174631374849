/* The level "dynamic" in plain C, for comparison only: the same algorithm as knee_contact_ros/model/solver.py.
 *
 * A circle on a plane under a law of one or more layers F = F0 + K (d - h)^n + C d'. Left out: giving up, the budget,
 * tension, laws that remember the impact, and all of an answer but depth, error estimate and evaluations.
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>

#define INLINE static inline __attribute__((always_inline))

enum { MAX_LAYERS = 4, APART = -1 };
enum { NOWHERE = -1, ABOVE, FORCE, BELOW };
static const double RELEASE = 8.0, DEPTH_ROUNDING = 1e-13, FORCE_ROUNDING = 1e-10;
static const double LOCAL_SHARE = 0.1, MEMORY = 1.0, ROUNDING = 4.0 * DBL_EPSILON, NEWTON_SHARE = 0.01;
static const double EXPLICIT = 1.0, MOST_EXPLICIT = 6.0, FINEST = 8.0;
static const double HORIZON = 0.1, SAFETY = 8.0, FAST_SWING = 5.0, SINGULAR = 10.0, STIFF = 100.0;

typedef struct { double begin, base, stiffness, exponent, damping; } Layer;
typedef struct {
    double surface, cosine, mass, tolerance; /* depth = surface - cosine height */
    int count;
    Layer layers[MAX_LAYERS];
} Scene;
typedef struct { double duration, load, load_rate; } Interval;
typedef struct { double height, velocity; } State; /* or its error */
typedef struct { double value, stiffness, damping; } Force;
typedef struct { double depth, rate, force, stiffness; } Stage;
typedef struct { int layer; bool pressing; } ContactMode;
typedef struct { ContactMode mode; Force force; } Entry;
typedef struct { int boundary; double fraction; } Crossing;
typedef struct { const Scene *scene; const Interval *interval; ContactMode mode; int known; } Motion;
typedef struct {
    State state, error;
    Stage begin, end;
    Crossing crossing;
    double stiffness, damping;
    int evaluations;
    bool solved;
} Step;
typedef struct { State state, error; double try_step, depth; bool touching; } RunState;
typedef struct { RunState run_state; double depth, error_estimate; int evaluations; bool smooth; } TickResult;
typedef struct {
    double s;
    State state, error;
    double try_step, spectral_radius;
    bool touching;
    double error_at_events;
    int evaluations;
} StepperState;

static const Crossing INSIDE = {NOWHERE, 1.0};

INLINE double smaller(double a, double b) { return b < a ? b : a; }
INLINE double larger(double a, double b) { return b > a ? b : a; }
INLINE double load_at(const Interval *interval, double s) { return interval->load + interval->load_rate * s; }
INLINE double depth_at(const Scene *scene, double height) { return scene->surface - scene->cosine * height; }

/* The contact law and its regions */

INLINE Force force_at(const Layer *layer, double depth, double rate) {
    double into = depth - layer->begin, elastic = 0.0, slope = 0.0;
    if (into > 0.0) {
        into = smaller(into, 1e30);
        double power = layer->stiffness * (layer->exponent == 1.5 ? sqrt(into) : pow(into, layer->exponent - 1.0));
        elastic = power * into;
        slope = layer->exponent * power;
    }
    return (Force){layer->base + elastic + layer->damping * rate, slope, layer->damping};
}

INLINE Force force_on(const Motion *motion, double depth, double rate) {
    return force_at(&motion->scene->layers[motion->mode.layer], depth, rate);
}

INLINE double force_rounding(double load) { return FORCE_ROUNDING * larger(1.0, fabs(load)); }

INLINE double depth_ahead(double depth, double rate) {
    return depth + (rate >= 0.0 ? DEPTH_ROUNDING : -DEPTH_ROUNDING);
}

static Entry enter_layer(const Scene *scene, int layer, double depth, double rate, double load) {
    if (layer < 0) return (Entry){{APART, false}, {0.0, 0.0, 0.0}};
    Force force = force_at(&scene->layers[layer], depth, rate);
    if (force.value >= -force_rounding(load)) return (Entry){{layer, true}, force};
    return (Entry){{layer, false}, {0.0, 0.0, 0.0}};
}

static Entry enter(const Scene *scene, double depth, double rate, double load) {
    int layer = -1;
    double ahead = depth_ahead(depth, rate);
    for (int i = 0; i < scene->count; i++) layer += scene->layers[i].begin <= ahead;
    return enter_layer(scene, layer, depth, rate, load);
}

INLINE double event_function(const Scene *scene, ContactMode mode, int boundary, double depth, double force) {
    if (boundary == ABOVE && mode.layer >= 0) return depth - scene->layers[mode.layer].begin;
    if (boundary == FORCE && mode.layer >= 0) return mode.pressing ? force : -force;
    if (boundary == BELOW && mode.layer + 1 < scene->count) return scene->layers[mode.layer + 1].begin - depth;
    return INFINITY;
}

INLINE double rounding(int boundary, double load) {
    return boundary == FORCE ? force_rounding(load) : DEPTH_ROUNDING;
}

INLINE Crossing earlier(Crossing found, const Motion *motion, const Stage *stage, double s, double fraction) {
    if (found.boundary != NOWHERE && found.fraction <= fraction) return found;
    double load = load_at(motion->interval, s);
    for (int boundary = ABOVE; boundary <= BELOW; boundary++) {
        if (fraction == 1.0 && boundary == motion->known) continue;
        if (event_function(motion->scene, motion->mode, boundary, stage->depth, stage->force) < -rounding(boundary, load))
            return (Crossing){boundary, fraction};
    }
    return found;
}

/* Errors of the linearised contact */

static State propagated_over_step(State error, double stiffness, double damping, double mass, double h) {
    double half_rate = 0.5 * damping / mass, discriminant = half_rate * half_rate - stiffness / mass;
    double root = sqrt(fabs(discriminant)), even, odd;
    if (discriminant > 0.0) {
        double slow = exp((root - half_rate) * h), fast = exp(-(root + half_rate) * h);
        even = 0.5 * (slow + fast);
        odd = 0.5 * (slow - fast) / root;
    } else {
        double decay = exp(-half_rate * h);
        even = discriminant < 0.0 ? decay * cos(root * h) : decay;
        odd = discriminant < 0.0 ? decay * sin(root * h) / root : decay * h;
    }
    return (State){
        (even + half_rate * odd) * error.height + odd * error.velocity,
        (even - half_rate * odd) * error.velocity - stiffness / mass * odd * error.height,
    };
}

static double decay_rate(double stiffness, double damping, double mass) {
    double half_rate = 0.5 * damping / mass, discriminant = half_rate * half_rate - stiffness / mass;
    return discriminant <= 0.0 ? half_rate : stiffness / mass / (half_rate + sqrt(discriminant));
}

static double spectral_radius(double stiffness, double damping, double mass) {
    double half_rate = 0.5 * damping / mass, discriminant = half_rate * half_rate - stiffness / mass;
    return discriminant <= 0.0 ? sqrt(stiffness / mass) : half_rate + sqrt(discriminant);
}

static double depth_error(State error, double stiffness, double damping, double mass) {
    double holding = larger(larger(sqrt(stiffness / mass), damping / mass), 1.0 / HORIZON);
    double becomes = error.velocity / holding;
    return sqrt(error.height * error.height + becomes * becomes);
}

static double swing(const Stage *stage, double load, double load_rate, double mass) {
    double excess = (stage->force - load) / sqrt(stage->stiffness * mass);
    double rate = stage->rate - load_rate / stage->stiffness;
    return sqrt(rate * rate + excess * excess);
}

static double lost_swing(const Step *step, const Interval *interval, double s, double mass, double h) {
    double half_rate = 0.5 * step->damping / mass, square = step->stiffness / mass, load = load_at(interval, s);
    if (square * h * h < FAST_SWING * FAST_SWING || half_rate * half_rate >= square) return 0.0;
    const Stage *begin = &step->begin, *end = &step->end;
    if (smaller(begin->stiffness, end->stiffness) < 0.25 * step->stiffness)
        return sqrt(2.0 * fabs((end->force - begin->force) * (end->depth - begin->depth)) / mass);
    double before = swing(begin, load, interval->load_rate, mass);
    double after = swing(end, load + interval->load_rate * h, interval->load_rate, mass);
    return larger(0.0, before * exp(-half_rate * h) - after);
}

static double local_ratio(
    const Scene *scene, State state, State error, double begin_force, double force, double stiffness, double damping,
    double h
) {
    double mass = scene->mass, speed = fabs(state.velocity) + h * fabs(force) / mass;
    State above = {
        larger(fabs(error.height) - ROUNDING * fabs(state.height), 0.0),
        larger(fabs(error.velocity) - ROUNDING * speed, 0.0),
    };
    double forgotten = smaller(1.0, h * larger(decay_rate(stiffness, damping, mass), 1.0 / MEMORY));
    double whole = depth_error(above, stiffness, damping, mass) / forgotten;
    if (force < RELEASE * (begin_force - force)) whole = larger(whole, depth_error(above, 0.0, 0.0, mass));
    return whole / (LOCAL_SHARE * scene->tolerance);
}

/* Fehlberg's method */

#define A21 (1.0 / 4)
#define A31 (3.0 / 32)
#define A32 (9.0 / 32)
#define A41 (1932.0 / 2197)
#define A42 (-7200.0 / 2197)
#define A43 (7296.0 / 2197)
#define A51 (439.0 / 216)
#define A52 (-8.0)
#define A53 (3680.0 / 513)
#define A54 (-845.0 / 4104)
#define A61 (-8.0 / 27)
#define A62 2.0
#define A63 (-3544.0 / 2565)
#define A64 (1859.0 / 4104)
#define A65 (-11.0 / 40)
#define B1 (25.0 / 216)
#define B3 (1408.0 / 2565)
#define B4 (2197.0 / 4104)
#define B5 (-1.0 / 5)
#define E1 (25.0 / 216 - 16.0 / 135)
#define E3 (1408.0 / 2565 - 6656.0 / 12825)
#define E4 (2197.0 / 4104 - 28561.0 / 56430)
#define E5 (-1.0 / 5 + 9.0 / 50)
#define E6 (-2.0 / 55)
#define C2 (1.0 / 4)
#define C3 (3.0 / 8)
#define C4 (12.0 / 13)
#define C6 (1.0 / 2)

typedef struct { double acceleration; Stage stage; double damping; } Slope;
typedef struct { State state, error; Slope middle, end; Crossing crossing; } Stride;

INLINE Slope slope_at(const Motion *motion, double s, double height, double velocity) {
    const Scene *scene = motion->scene;
    double depth = depth_at(scene, height), rate = -scene->cosine * velocity;
    Force force = force_on(motion, depth, rate);
    double acceleration = (scene->cosine * force.value - load_at(motion->interval, s)) * (1.0 / scene->mass);
    return (Slope){acceleration, {depth, rate, force.value, force.stiffness}, force.damping};
}

INLINE Stride fehlberg_stride(const Motion *motion, double s, State state, double h, const Slope *one) {
    double y = state.height, v = state.velocity, a = one->acceleration;
    double v2 = v + h * A21 * a;
    Slope two = slope_at(motion, s + C2 * h, y + h * A21 * v, v2);
    double a2 = two.acceleration, v3 = v + h * (A31 * a) + h * A32 * a2;
    Slope three = slope_at(motion, s + C3 * h, y + h * (A31 * v) + h * A32 * v2, v3);
    double a3 = three.acceleration, v4 = v + h * (A41 * a + A42 * a2) + h * A43 * a3;
    Slope four = slope_at(motion, s + C4 * h, y + h * (A41 * v + A42 * v2) + h * A43 * v3, v4);
    double a4 = four.acceleration, v5 = v + h * (A51 * a + A52 * a2 + A53 * a3) + h * A54 * a4;
    Slope five = slope_at(motion, s + h, y + h * (A51 * v + A52 * v2 + A53 * v3) + h * A54 * v4, v5);
    double a5 = five.acceleration, v6 = v + h * (A61 * a + A62 * a2 + A63 * a3 + A64 * a4) + h * A65 * a5;
    Slope six = slope_at(motion, s + C6 * h, y + h * (A61 * v + A62 * v2 + A63 * v3 + A64 * v4) + h * A65 * v5, v6);
    double a6 = six.acceleration;

    State to = {y + h * (B1 * v + B3 * v3 + B4 * v4) + h * B5 * v5, v + h * (B1 * a + B3 * a3 + B4 * a4) + h * B5 * a5};
    Slope end = slope_at(motion, s + h, to.height, to.velocity);
    double from_depth = one->stage.depth, to_depth = end.stage.depth;
    double layer_begin = motion->scene->layers[motion->mode.layer].begin;
    bool begins_layer = fabs(to_depth - from_depth) >= smaller(from_depth, to_depth) - layer_begin;
    double estimate = begins_layer ? h * SINGULAR : h;
    State error = {
        estimate * (E1 * v + E3 * v3 + E4 * v4 + E5 * v5 + E6 * v6),
        estimate * (E1 * a + E3 * a3 + E4 * a4 + E5 * a5 + E6 * a6),
    };
    Crossing crossing = earlier(INSIDE, motion, &two.stage, s + C2 * h, C2);
    crossing = earlier(crossing, motion, &three.stage, s + C3 * h, C3);
    crossing = earlier(crossing, motion, &six.stage, s + C6 * h, C6);
    crossing = earlier(crossing, motion, &four.stage, s + C4 * h, C4);
    crossing = earlier(crossing, motion, &end.stage, s + h, 1.0);
    return (Stride){to, error, six, end, crossing};
}

static Step fehlberg_step(const Motion *motion, double s, State state, double h) {
    Slope begin = slope_at(motion, s, state.height, state.velocity);
    Stride stride = fehlberg_stride(motion, s, state, h, &begin);
    double square = motion->scene->cosine * motion->scene->cosine;
    return (Step){
        stride.state, stride.error, begin.stage, stride.end.stage, stride.crossing,
        square * stride.middle.stage.stiffness, square * stride.middle.damping, 7, true,
    };
}

/* The implicit method, doubled */

typedef struct {
    double velocity, acceleration;
    Stage stage;
    double stiffness, damping;
    int evaluations;
    bool arrived;
} Solved;

static Solved solve_stage(
    const Motion *motion, double s, double height, double velocity, double diagonal, double guess, double resolution
) {
    double cosine = motion->scene->cosine, mass = motion->scene->mass, load = load_at(motion->interval, s);
    double unknown = velocity + diagonal * guess, depth = 0.0, rate = 0.0, force_slope = 0.0, correction = 0.0;
    Force force = {0.0, 0.0, 0.0};
    int evaluations = 0;
    bool arrived = false;
    while (!arrived && evaluations < 30) {
        depth = depth_at(motion->scene, height + diagonal * unknown);
        rate = -cosine * unknown;
        force = force_on(motion, depth, rate);
        evaluations++;
        force_slope = cosine * (diagonal * force.stiffness + force.damping);
        double residual = mass * (unknown - velocity) - diagonal * (cosine * force.value - load);
        correction = residual / (mass + diagonal * cosine * force_slope);
        unknown -= correction;
        arrived = fabs(correction) * diagonal <= larger(smaller(resolution, 1e-4 * depth), 1e-16);
    }
    if (arrived) {
        force.value += force_slope * correction;
        depth += cosine * diagonal * correction;
        rate += cosine * correction;
    }
    return (Solved){
        unknown, (cosine * force.value - load) / mass, {depth, rate, force.value, force.stiffness},
        cosine * cosine * force.stiffness, cosine * cosine * force.damping, evaluations, arrived,
    };
}

static Step esdirk4_step(const Motion *motion, double s, State state, double h, double resolution) {
    const double c2 = 1.0 / 2, c3 = 83.0 / 250, c4 = 31.0 / 50, c5 = 17.0 / 20, a21 = 1.0 / 4;
    const double a31 = 8611.0 / 62500, a32 = -1743.0 / 31250;
    const double a41 = 5012029.0 / 34652500, a42 = -654441.0 / 2922500, a43 = 174375.0 / 388108;
    const double a51 = 15267082809.0 / 155376265600.0, a52 = -71443401.0 / 120774400, a53 = 730878875.0 / 902184768;
    const double a54 = 2285395.0 / 8070912;
    const double a61 = 82889.0 / 524892, a63 = 15625.0 / 83664, a64 = 69875.0 / 102672, a65 = -2260.0 / 8211;
    double y = state.height, v = state.velocity, d = h * (1.0 / 4), mass = motion->scene->mass;
    double depth = depth_at(motion->scene, y), rate = -motion->scene->cosine * v;
    Force force = force_on(motion, depth, rate);
    Stage begin = {depth, rate, force.value, force.stiffness};
    double a = (motion->scene->cosine * force.value - load_at(motion->interval, s)) / mass;

    Solved one = solve_stage(motion, s + c2 * h, y + h * (a21 * v), v + h * (a21 * a), d, a, resolution);
    double v2 = one.velocity, a2 = one.acceleration;
    Solved two = solve_stage(
        motion, s + c3 * h, y + h * (a31 * v + a32 * v2), v + h * (a31 * a + a32 * a2), d, a2, resolution);
    double v3 = two.velocity, a3 = two.acceleration;
    Solved three = solve_stage(
        motion, s + c4 * h, y + h * (a41 * v + a42 * v2 + a43 * v3), v + h * (a41 * a + a42 * a2 + a43 * a3), d, a3,
        resolution);
    double v4 = three.velocity, a4 = three.acceleration;
    Solved four = solve_stage(
        motion, s + c5 * h, y + h * (a51 * v + a52 * v2 + a53 * v3 + a54 * v4),
        v + h * (a51 * a + a52 * a2 + a53 * a3 + a54 * a4), d, a4, resolution);
    double v5 = four.velocity, a5 = four.acceleration;
    double known_height = y + h * (a61 * v + a63 * v3 + a64 * v4 + a65 * v5);
    double known_velocity = v + h * (a61 * a + a63 * a3 + a64 * a4 + a65 * a5);
    Solved five = solve_stage(motion, s + h, known_height, known_velocity, d, a5, resolution);

    Crossing crossing = earlier(INSIDE, motion, &two.stage, s + c3 * h, c3);
    crossing = earlier(crossing, motion, &one.stage, s + c2 * h, c2);
    crossing = earlier(crossing, motion, &three.stage, s + c4 * h, c4);
    crossing = earlier(crossing, motion, &four.stage, s + c5 * h, c5);
    crossing = earlier(crossing, motion, &five.stage, s + h, 1.0);
    return (Step){
        {known_height + d * five.velocity, five.velocity}, {0.0, 0.0}, begin, five.stage, crossing,
        five.stiffness, five.damping,
        1 + one.evaluations + two.evaluations + three.evaluations + four.evaluations + five.evaluations,
        one.arrived && two.arrived && three.arrived && four.arrived && five.arrived,
    };
}

static Step doubled_step(const Motion *motion, double s, State state, double h, double resolution) {
    Motion open = *motion;
    open.known = NOWHERE;
    Step whole = esdirk4_step(motion, s, state, h, resolution);
    Step first = esdirk4_step(&open, s, state, 0.5 * h, resolution);
    Step step = esdirk4_step(motion, s + 0.5 * h, first.state, 0.5 * h, resolution);
    bool stiff = h * (h * first.stiffness + first.damping) > STIFF * motion->scene->mass;
    double gain = stiff ? 3.0 : 15.0;
    step.crossing.fraction = 0.5 + 0.5 * step.crossing.fraction;
    if (first.crossing.boundary != NOWHERE)
        step.crossing = (Crossing){first.crossing.boundary, 0.5 * first.crossing.fraction};
    step.error.height = (step.state.height - whole.state.height) / gain;
    step.error.velocity = (step.state.velocity - whole.state.velocity) / gain;
    step.begin = first.begin;
    step.stiffness = first.stiffness;
    step.damping = first.damping;
    step.evaluations += whole.evaluations + first.evaluations;
    step.solved = step.solved && whole.solved && first.solved;
    return step;
}

/* Free flight */

static State flight(const Motion *motion, double s, State state, double t) {
    double load = load_at(motion->interval, s), load_rate = motion->interval->load_rate, mass = motion->scene->mass;
    return (State){
        state.height + t * (state.velocity - t * (0.5 * load + load_rate * t / 6.0) / mass),
        state.velocity - t * (load + 0.5 * load_rate * t) / mass,
    };
}

static State propagated_in_flight(State error, double h) {
    double reached = error.height + h * error.velocity;
    return (State){copysign(fabs(error.height) + h * fabs(error.velocity), reached), error.velocity};
}

static double launch_rounding(State begin, State end) { return 2e-12 * fabs(end.height - begin.height); }

static Stage in_flight(const Motion *motion, double s, State state, double t) {
    State there = flight(motion, s, state, t);
    double depth = depth_at(motion->scene, there.height), rate = -motion->scene->cosine * there.velocity;
    double force = motion->mode.layer >= 0 ? force_on(motion, depth, rate).value : 0.0;
    return (Stage){depth, rate, force, 0.0};
}

static Crossing towards_peak(
    Crossing crossing, const Motion *motion, double s, State state, double h, double low, double high, double rising,
    double falling, int *looks
) {
    double last = 0.0;
    for (int i = 0; i < 12; i++) {
        double middle = low + (high - low) * rising / (rising - falling);
        if (!(low < middle && middle < high)) break;
        Stage stage = in_flight(motion, s, state, middle * h);
        ++*looks;
        crossing = earlier(crossing, motion, &stage, s + middle * h, middle);
        if (fabs(stage.rate) <= 1e-9) break;
        bool again = stage.rate * last > 0.0;
        if (stage.rate > 0.0) {
            low = middle, rising = stage.rate;
            falling = again ? 0.5 * falling : falling;
        } else {
            high = middle, falling = stage.rate;
            rising = again ? 0.5 * rising : rising;
        }
        last = stage.rate;
    }
    return crossing;
}

static Step free_flight_step(const Motion *motion, double s, State state, double h) {
    Stage begin = in_flight(motion, s, state, 0.0), before = begin;
    Crossing crossing = INSIDE;
    int looks = 1;
    for (int part = 1; part <= 4; part++) {
        double low = (part - 1) / 4.0, high = part / 4.0;
        Stage stage = in_flight(motion, s, state, high * h);
        looks++;
        if (before.rate > 0.0 && 0.0 > stage.rate)
            crossing = towards_peak(crossing, motion, s, state, h, low, high, before.rate, stage.rate, &looks);
        crossing = earlier(crossing, motion, &stage, s + high * h, high);
        before = stage;
    }
    State end = flight(motion, s, state, h), error = {launch_rounding(state, end), 0.0};
    return (Step){end, error, begin, before, crossing, 0.0, 0.0, motion->mode.layer >= 0 ? looks : 0, true};
}

/* Steps with error control, which end on boundaries */

static Step attempt(
    const Scene *scene, const Interval *interval, StepperState *stepper, ContactMode mode, double h, int known
) {
    Motion motion = {scene, interval, mode, known};
    Step step;
    if (!mode.pressing) step = free_flight_step(&motion, stepper->s, stepper->state, h);
    else if (stepper->spectral_radius * h <= EXPLICIT) step = fehlberg_step(&motion, stepper->s, stepper->state, h);
    else step = doubled_step(&motion, stepper->s, stepper->state, h, NEWTON_SHARE * scene->tolerance);
    stepper->evaluations += step.evaluations;
    return step;
}

static double error_ratio(
    const Scene *scene, const Interval *interval, const StepperState *stepper, const Step *step, double h
) {
    if (!step->solved) return INFINITY;
    double ratio = local_ratio(
        scene, step->state, step->error, step->begin.force, step->end.force, step->stiffness, step->damping, h
    );
    State lost = {0.0, lost_swing(step, interval, stepper->s, scene->mass, h)};
    ratio += depth_error(lost, step->stiffness, step->damping, scene->mass) / (LOCAL_SHARE * scene->tolerance);
    return ratio < INFINITY ? ratio : INFINITY;
}

static Step controlled_step(const Scene *scene, const Interval *interval, StepperState *stepper, ContactMode mode, double *taken) {
    double remaining = interval->duration - stepper->s;
    double h = mode.pressing ? smaller(stepper->try_step, remaining) : remaining;
    if (EXPLICIT < stepper->spectral_radius * h && stepper->spectral_radius * remaining <= MOST_EXPLICIT * EXPLICIT && mode.pressing)
        h = remaining / ceil(stepper->spectral_radius * remaining / EXPLICIT);
    for (;;) {
        Step step = attempt(scene, interval, stepper, mode, h, NOWHERE);
        *taken = h;
        if (!mode.pressing) return step;
        double ratio = error_ratio(scene, interval, stepper, &step, h), factor = 0.9 / sqrt(sqrt(larger(ratio, 1e-4)));
        if (ratio <= 1.0) {
            stepper->try_step = h < remaining ? h * factor : larger(stepper->try_step, h * factor);
            return step;
        }
        h *= larger(0.1, factor);
    }
}

static Step end_on_boundary(
    const Scene *scene, const Interval *interval, StepperState *stepper, ContactMode mode, const Step *crossing, double *h,
    int *ended_on
) {
    int boundary = crossing->crossing.boundary;
    double high = crossing->crossing.fraction * *h, enough = rounding(boundary, load_at(interval, stepper->s));
    Stage begin = crossing->begin;
    Step step = attempt(scene, interval, stepper, mode, high, boundary);
    double beyond = event_function(scene, mode, boundary, step.end.depth, step.end.force);
    *ended_on = NOWHERE;
    *h = high;
    if (beyond >= 0.0) return step;
    double low = 0.0, inside = event_function(scene, mode, boundary, begin.depth, begin.force), last = 0.0;
    if (inside <= enough) {
        for (int i = 0; i < 3; i++) {
            *h *= 0.1;
            step = attempt(scene, interval, stepper, mode, *h, boundary);
            if (event_function(scene, mode, boundary, step.end.depth, step.end.force) > enough) return step;
        }
        *h = 0.0;
        *ended_on = boundary;
        return (Step){stepper->state, {0.0, 0.0}, begin, begin, INSIDE, 0.0, 0.0, 0, true};
    }
    *ended_on = boundary;
    for (int i = 0; i < 60; i++) {
        *h = low + (high - low) * inside / (inside - beyond);
        if (!(low < *h && *h < high)) break;
        step = attempt(scene, interval, stepper, mode, *h, boundary);
        double value = event_function(scene, mode, boundary, step.end.depth, step.end.force);
        if (fabs(value) <= 0.01 * enough) break;
        bool again = value * last > 0.0;
        if (value < 0.0) {
            high = *h, beyond = value;
            inside = again ? 0.5 * inside : inside;
        } else {
            low = *h, inside = value;
            beyond = again ? 0.5 * beyond : beyond;
        }
        last = value;
    }
    return step;
}

static double spectral_radius_in(const Scene *scene, Entry entry) {
    double square = scene->cosine * scene->cosine;
    if (!entry.mode.pressing) return 0.0;
    return spectral_radius(square * entry.force.stiffness, square * entry.force.damping, scene->mass);
}

static void accept(
    const Scene *scene, const Interval *interval, StepperState *stepper, ContactMode mode, const Step *step, double h
) {
    State propagated;
    double lost = lost_swing(step, interval, stepper->s, scene->mass, h);
    State error = stepper->error;
    if (mode.pressing) propagated = propagated_over_step(error, step->stiffness, step->damping, scene->mass, h);
    else propagated = propagated_in_flight(error, h);
    double velocity = propagated.velocity + step->error.velocity;
    stepper->spectral_radius = mode.pressing ? spectral_radius(step->stiffness, step->damping, scene->mass) : 0.0;
    stepper->s = h == interval->duration - stepper->s ? interval->duration : stepper->s + h;
    stepper->state = step->state;
    stepper->error = (State){propagated.height + step->error.height, velocity + copysign(lost, velocity)};
}

static ContactMode behind_boundary(
    const Scene *scene, const Interval *interval, StepperState *stepper, ContactMode mode, const Step *step, int boundary
) {
    double depth = step->end.depth, rate = step->end.rate;
    Entry entry;
    if (boundary != FORCE) {
        int layer = mode.layer + (boundary == BELOW ? 1 : -1);
        entry = enter_layer(scene, layer, depth, rate, load_at(interval, stepper->s));
    } else if (mode.pressing) {
        entry = (Entry){{mode.layer, false}, {0.0, 0.0, 0.0}};
    } else {
        entry = (Entry){{mode.layer, true}, force_at(&scene->layers[mode.layer], depth, rate)};
    }
    double jump = entry.force.value - (mode.pressing ? step->end.force : 0.0);
    double late = copysign(interval->duration, stepper->error.height * rate);
    if (fabs(stepper->error.height) < fabs(late * rate)) late = stepper->error.height / rate;
    stepper->error_at_events = larger(stepper->error_at_events, fabs(stepper->error.height));
    if (mode.pressing && !entry.mode.pressing) {
        double swung = stepper->error.height * sqrt(step->stiffness / scene->mass), velocity = stepper->error.velocity;
        stepper->error.velocity = copysign(sqrt(velocity * velocity + swung * swung), velocity);
    }
    double off = boundary == FORCE ? 0.0 : event_function(scene, mode, boundary, depth, step->end.force);
    double beside = rate != 0.0 ? smaller(interval->duration, fabs(off / rate)) : 0.0;
    stepper->error.velocity -= late * jump / scene->mass;
    stepper->error.velocity += copysign(beside * jump / scene->mass, stepper->error.velocity);
    stepper->spectral_radius = spectral_radius_in(scene, entry);
    stepper->touching = entry.mode.layer >= 0;
    stepper->evaluations += entry.mode.pressing || (boundary != FORCE && entry.mode.layer >= 0);
    return entry.mode;
}

static TickResult stepwise(const Scene *scene, const Interval *interval, const RunState *start, int spent) {
    StepperState stepper = {0.0, start->state, start->error, start->try_step, 0.0, start->touching, 0.0, spent};
    double depth = depth_at(scene, stepper.state.height), rate = -scene->cosine * stepper.state.velocity;
    stepper.touching = stepper.touching || depth_ahead(depth, rate) >= 0.0;
    Entry entry = enter(scene, depth, rate, interval->load);
    ContactMode mode = entry.mode;
    stepper.evaluations += mode.layer >= 0;
    stepper.spectral_radius = spectral_radius_in(scene, entry);
    while (stepper.s < interval->duration) {
        double h;
        int boundary = NOWHERE;
        Step step = controlled_step(scene, interval, &stepper, mode, &h);
        while (h > 0.0 && step.crossing.boundary != NOWHERE)
            step = end_on_boundary(scene, interval, &stepper, mode, &step, &h, &boundary);
        accept(scene, interval, &stepper, mode, &step, h);
        if (boundary != NOWHERE) mode = behind_boundary(scene, interval, &stepper, mode, &step, boundary);
    }
    depth = depth_at(scene, stepper.state.height);
    rate = -scene->cosine * stepper.state.velocity;
    double error = fabs(stepper.error.height);
    if (mode.pressing) {
        Force force = force_at(&scene->layers[mode.layer], depth, rate);
        stepper.evaluations++;
        error = depth_error(stepper.error, force.stiffness, force.damping, scene->mass);
    }
    RunState run_state = {stepper.state, stepper.error, stepper.try_step, depth, stepper.touching};
    return (TickResult){run_state, depth, SAFETY * larger(error, stepper.error_at_events), stepper.evaluations, true};
}

/* Ticks */

static TickResult smooth_tick(const Scene *scene, const Interval *interval, const RunState *start) {
    TickResult result = {*start, 0.0, 0.0, 0, false};
    double h = interval->duration, mass = scene->mass, square = scene->cosine * scene->cosine;
    State state = start->state, error = start->error;
    if (!start->touching) return result;
    double depth = depth_at(scene, state.height), rate = -scene->cosine * state.velocity;
    Entry entry = enter(scene, depth, rate, interval->load);
    result.evaluations += entry.mode.layer >= 0;
    if (!entry.mode.pressing) return result;
    Force force = entry.force;
    double spectral = spectral_radius(square * force.stiffness, square * force.damping, mass);
    double parts = ceil(larger(larger(1.0, h * spectral / EXPLICIT), h / start->try_step));
    if (parts > smaller(FINEST, h * spectral > EXPLICIT ? MOST_EXPLICIT : FINEST)) return result;

    Motion motion = {scene, interval, entry.mode, NOWHERE};
    Stage begin = {depth, rate, force.value, force.stiffness};
    Slope slope = {(scene->cosine * force.value - interval->load) / mass, begin, force.damping};
    double part = h / parts, largest = 0.0;
    for (int i = 0; i < (int)parts; i++) {
        Stride stride = fehlberg_stride(&motion, i * part, state, part, &slope);
        result.evaluations += 6;
        double stiffness = square * stride.middle.stage.stiffness, damping = square * stride.middle.damping;
        double ratio = local_ratio(
            scene, stride.state, stride.error, slope.stage.force, stride.end.stage.force, stiffness, damping, part
        );
        if (stride.crossing.boundary != NOWHERE || !(ratio <= 1.0)) return result;
        State propagated = propagated_over_step(error, stiffness, damping, mass, part);
        error = (State){propagated.height + stride.error.height, propagated.velocity + stride.error.velocity};
        state = stride.state;
        slope = stride.end;
        largest = larger(largest, ratio);
    }
    double try_step = part * (0.9 / sqrt(sqrt(larger(largest, 1e-4))));
    if (parts == 1.0) try_step = larger(start->try_step, try_step);
    result.run_state = (RunState){state, error, try_step, slope.stage.depth, true};
    result.depth = slope.stage.depth;
    result.error_estimate = SAFETY * depth_error(error, slope.stage.stiffness, slope.damping, mass);
    result.smooth = true;
    return result;
}

static bool flies_freely(const Scene *scene, const Interval *interval, const RunState *start) {
    double h = interval->duration, load = larger(fabs(interval->load), fabs(load_at(interval, h)));
    return !start->touching && -start->depth > h * (fabs(start->state.velocity) + 0.5 * load * h / scene->mass);
}

static TickResult flying_tick(const Scene *scene, const Interval *interval, const RunState *start) {
    Motion motion = {scene, interval, {APART, false}, NOWHERE};
    State state = flight(&motion, 0.0, start->state, interval->duration);
    State error = propagated_in_flight(start->error, interval->duration);
    error.height += launch_rounding(start->state, state);
    double depth = depth_at(scene, state.height);
    RunState run_state = {state, error, start->try_step, depth, false};
    return (TickResult){run_state, depth, SAFETY * fabs(error.height), 0, true};
}

static TickResult dynamic_tick(const Scene *scene, const Interval *interval, const RunState *start) {
    if (flies_freely(scene, interval, start)) return flying_tick(scene, interval, start);
    TickResult result = smooth_tick(scene, interval, start);
    return result.smooth ? result : stepwise(scene, interval, start, result.evaluations);
}

static double height_at(const Scene *scene, double depth, double height) {
    for (int i = 0; i < 200; i++) {
        double correction = (depth_at(scene, height) - depth) / scene->cosine;
        height += correction;
        if (fabs(correction) <= 1e-16 * larger(1.0, fabs(height)) || height + 0.5 * correction == height) break;
    }
    return height;
}

static TickResult start_at_rest(const Scene *scene, double load) {
    double force = load / scene->cosine, depth = 0.0;
    int evaluations = 0, layer = 0;
    if (force > 0.0) {
        for (int i = 1; i < scene->count; i++, evaluations++)
            if (force_at(&scene->layers[i - 1], scene->layers[i].begin, 0.0).value < force) layer = i;
        const Layer *in = &scene->layers[layer];
        double low = in->begin, high;
        depth = larger(2.0 * low, 1e-9);
        evaluations++;
        for (; depth < 1e9 && force_at(in, depth, 0.0).value < force; evaluations++) low = depth, depth = 10.0 * depth;
        high = depth;
        for (int i = 0; i < 200; i++) {
            Force at = force_at(in, depth, 0.0);
            evaluations++;
            *(at.value >= force ? &high : &low) = depth;
            double newton = at.stiffness > 0.0 ? depth - (at.value - force) / at.stiffness : low;
            double following = low < newton && newton < high ? newton : 0.5 * (low + high);
            double correction = fabs(following - depth);
            if (correction == 0.0 || !(low < following && following < high) || correction <= 1e-16 * depth) break;
            depth = following;
        }
        evaluations++;
    }
    double height = height_at(scene, depth, height_at(scene, 0.0, 0.1));
    RunState run_state = {{height, 0.0}, {0.0, 0.0}, INFINITY, depth, true};
    return (TickResult){run_state, depth, 0.0, evaluations, true};
}

void run(
    const double *durations, const double *loads, int n, double surface, double cosine, double mass, double tolerance,
    const Layer *layers, int count, double *depth, double *error_estimate, int *evaluations
) {
    Scene scene = {.surface = surface, .cosine = cosine, .mass = mass, .tolerance = tolerance, .count = count};
    for (int i = 0; i < count; i++) scene.layers[i] = layers[i];
    TickResult result = start_at_rest(&scene, loads[0]);
    for (int i = 0; i < n; i++) {
        if (i > 0) {
            Interval interval = {durations[i], loads[i - 1], (loads[i] - loads[i - 1]) / durations[i]};
            result = dynamic_tick(&scene, &interval, &result.run_state);
        }
        depth[i] = result.depth;
        error_estimate[i] = result.error_estimate;
        evaluations[i] = result.evaluations;
    }
}
