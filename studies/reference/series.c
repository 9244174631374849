#include "series.h"

real value_of(const real *c, int degree, real t) {
    real sum = 0.0L;
    for (int k = degree; k >= 0; k--) sum = sum * t + c[k];
    return sum;
}

real slope_of(const real *c, int degree, real t) {
    real sum = 0.0L;
    for (int k = degree; k >= 1; k--) sum = sum * t + (real)k * c[k];
    return sum;
}

/* The support's growth since the tick began, from its square q = (aa + bb)/2 - (aa - bb)/2 cos 2 phi. */
static void develop_support(const Knee *k, const Tick *t, real s, int degree, real *h, real *growth) {
    real d = k->aa - k->bb, rate;
    for (int i = 0; i <= degree; i++) growth[i] = 0.0L;
    if (d == 0.0L || t->turn == 0.0L) return;
    growth[0] = grown(k, t, s, &rate);
    real phi = t->phi + t->turn * s, twice = 2.0L * t->turn, scale = -0.5L * d;
    real sine = sinl(2.0L * phi), cosine = cosl(2.0L * phi);
    real cycle[4] = {cosine, -sine, -cosine, sine};
    h[0] = support(k, phi);
    for (int i = 1; i <= degree; i++) {
        scale *= twice / (real)i;
        real sum = scale * cycle[i & 3];
        for (int j = 1; j < i; j++) sum -= h[j] * h[i - j];
        h[i] = growth[i] = sum / (2.0L * h[0]);
    }
}

/* Term i of w^n from the terms of w up to i and those of the power below i. */
static real power_term(const real *w, const real *p, real *square, real n, int i) {
    real sum = 0.0L;
    if (n == 1.0L) return w[i];
    if (n == 2.0L || n == 3.0L) {
        for (int j = 0; j <= i; j++) sum += w[j] * w[i - j];
        if (n == 2.0L) return sum;
        square[i] = sum;
        sum = 0.0L;
        for (int j = 0; j <= i; j++) sum += square[j] * w[i - j];
        return sum;
    }
    real slope;
    if (i == 0) return power(w[0], n, &slope);
    for (int j = 1; j <= i; j++) sum += ((n + 1.0L) * (real)j - (real)i) * w[j] * p[i - j];
    return sum / ((real)i * w[0]);
}

static int whole(real n) { return n == 1.0L || n == 2.0L || n == 3.0L; }

void develop(const Knee *k, const Tick *t, const Mode *m, real s, real height, real velocity, int degree, Series *out) {
    real h[MOST_TERMS + 1], growth[MOST_TERMS + 1], w[MOST_TERMS + 1], p[MOST_TERMS + 1], square[MOST_TERMS + 1];
    const Layer *layer = m->layer >= 0 ? &k->layer[m->layer] : 0;
    real d = loss_over_speed(k, m), *y = out->height, *depth = out->depth;
    out->degree = degree;
    out->singular = 0;
    develop_support(k, t, s, degree, h, growth);
    y[0] = height;
    y[1] = velocity;
    depth[0] = t->depth + growth[0] - k->cosine * height;
    depth[1] = growth[1] - k->cosine * velocity;
    if (layer && m->on == ABOVE) depth[0] = layer->begin;
    if (m->on == BELOW) depth[0] = m->layer < 0 ? 0.0L : k->layer[m->layer + 1].begin;
    if (layer) {
        w[0] = depth[0] - layer->begin;
        w[1] = depth[1];
        if (m->on == ABOVE) w[0] = 0.0L;
        out->singular = w[0] <= 0.0L && !whole(layer->exponent);
    }
    for (int i = 0; i + 2 <= degree; i++) {
        real force = 0.0L, rate = (real)(i + 1) * depth[i + 1];
        if (layer) {
            p[i] = out->singular ? 0.0L : power_term(w, p, square, layer->exponent, i);
            if (k->loss > 0.0L) {
                out->value[i] = d * rate + (i == 0 ? 1.0L : 0.0L);
                for (int j = 0; j <= i; j++) force += p[j] * out->value[i - j];
                force *= layer->stiffness;
            } else {
                force = (i == 0 ? layer->base : 0.0L) + layer->stiffness * p[i] + layer->damping * rate;
                out->value[i] = force;
            }
        }
        out->force[i] = force;
        real load = i == 0 ? t->load + t->load_rate * s : i == 1 ? t->load_rate : 0.0L;
        real push = (m->pressing ? k->cosine * force : 0.0L) - load;
        y[i + 2] = push / (k->mass * (real)((i + 1) * (i + 2)));
        depth[i + 2] = growth[i + 2] - k->cosine * y[i + 2];
        w[i + 2] = depth[i + 2];
    }
}

static double binary_logarithm(real x) {
    int exponent;
    double fraction = (double)frexpl(fabsl(x), &exponent);
    return (double)exponent + log2(fraction);
}

/* Logarithm of the duration for which the last terms, times their `lower` th power's order, stay below the tolerance. Series
   may lack all terms but every fifth or eighth: terms before the last count too, with four times the tolerance each. */
static double allowed(const real *c, int degree, int lower, real tolerance) {
    double least = 1e300, wanted = binary_logarithm(tolerance);
    for (int i = degree; i > degree - 9 && i > lower; i--) {
        if (c[i] == 0.0L) continue;
        double slack = 2.0 * (double)(degree - i);
        double own = (wanted + slack - binary_logarithm(c[i]) - log2((double)i)) / (double)(i - lower);
        least = fmin(least, own);
    }
    return least;
}

real reach(const Knee *k, const Mode *m, Series *series, real tolerance, real force_tolerance) {
    series->stiff = 0;
    if (series->singular && m->pressing) return 0.0L;
    double least = allowed(series->depth, series->degree, 1, tolerance);
    least = fmin(least, allowed(series->height, series->degree, 1, tolerance));
    if (m->pressing) {
        least = fmin(least, allowed(series->force, series->degree - 2, 0, force_tolerance));
        real stiffness, damping, depth = series->depth[0], rate = series->depth[1];
        formula(k, m, depth, rate, &stiffness, &damping);
        real swift = k->cosine * k->cosine * damping / k->mass;
        double most = swift > 0.0L ? 3.0 - binary_logarithm(swift) : 1e300; /* 8 times the decay at most */
        series->stiff = most < least;
        least = fmin(least, most);
    } else if (may_pull(k, m)) {
        real enough = fmaxl(force_tolerance, 1e-6L * fabsl(series->value[0]));
        least = fmin(least, allowed(series->value, series->degree - 2, 0, enough));
    }
    if (least > 60.0) return 1e18L;
    return ldexpl((real)exp2(least - floor(least)), (int)floor(least));
}

/* The zero between `low`, where the polynomial is >= 0, and `high`, where it is < 0. */
static real zero_between(const real *c, int degree, real low, real high) {
    real t = 0.5L * (low + high);
    for (int i = 0; i < 200; i++) {
        real v = value_of(c, degree, t), slope = slope_of(c, degree, t);
        if (v < 0.0L) high = t;
        else low = t;
        real next = slope != 0.0L ? t - v / slope : low;
        if (!(next > low && next < high)) next = 0.5L * (low + high);
        if (next == t || next <= low || next >= high || fabsl(next - t) <= 1e-19L * fabsl(t)) return next;
        t = next;
    }
    return t;
}

/* Where a polynomial that falls at `low` and rises at `high` is least. */
static real least_between(const real *c, int degree, real low, real high) {
    for (int i = 0; i < 70; i++) {
        real t = 0.5L * (low + high);
        if (slope_of(c, degree, t) < 0.0L) low = t;
        else high = t;
    }
    return 0.5L * (low + high);
}

/* Whether a polynomial certainly stays positive over a duration: a quick look in double precision. */
static int stays_positive(const real *c, int degree, real duration) {
    double scaled[MOST_TERMS + 1], sum = 0.0;
    real factor = 1.0L;
    for (int k = 0; k <= degree; k++, factor *= duration) {
        scaled[k] = (double)(c[k] * factor);
        sum += k > 0 ? fabs(scaled[k]) : 0.0;
    }
    if (scaled[0] > sum) return 1;
    const int cells = 16;
    double last = scaled[0], last_slope = scaled[1], least = 1e-9 * (sum + scaled[0]);
    if (!(last > least)) return 0;
    for (int i = 1; i <= cells; i++) {
        double t = (double)i / cells, value = scaled[degree], slope = 0.0;
        for (int k = degree - 1; k >= 0; k--) {
            slope = slope * t + value;
            value = value * t + scaled[k];
        }
        double dip = last_slope < 0.0 && slope > 0.0 ? fmin(-last_slope, slope) / cells : 0.0;
        if (!(fmin(last, value) - dip > least)) return 0;
        last = value;
        last_slope = slope;
    }
    return 1;
}

/* First time within a duration at which a polynomial becomes negative; `on`: it begins at 0. */
static int first_zero(const real *c, int degree, real duration, int on, real *when) {
    if (on) c++, degree--;
    while (degree > 0 && c[0] == 0.0L) c++, degree--;
    *when = 0.0L;
    if (c[0] < 0.0L) return 1;
    if (c[0] == 0.0L) return 0;
    if (stays_positive(c, degree, duration)) return 0;
    const int cells = 32;
    real last = 0.0L, last_slope = c[1];
    for (int i = 1; i <= cells; i++) {
        real t = duration * (real)i / (real)cells, slope = slope_of(c, degree, t);
        real end = t;
        int crossed = value_of(c, degree, t) < 0.0L;
        if (!crossed && last_slope < 0.0L && slope > 0.0L) {
            end = least_between(c, degree, last, t);
            crossed = value_of(c, degree, end) < 0.0L;
        }
        if (crossed) {
            *when = zero_between(c, degree, last, end);
            return 1;
        }
        last = t;
        last_slope = slope;
    }
    return 0;
}

int first_crossing(const Knee *k, const Mode *m, const Series *series, real duration, real *when) {
    real c[MOST_TERMS + 1] = {0}, t;
    int boundary = NOWHERE;
    *when = duration;
    if (m->layer >= 0) {
        for (int i = 0; i <= series->degree; i++) c[i] = series->depth[i];
        c[0] -= k->layer[m->layer].begin;
        if (first_zero(c, series->degree, *when, m->on == ABOVE, &t)) *when = t, boundary = ABOVE;
    }
    if (m->layer + 1 < k->layers) {
        for (int i = 0; i <= series->degree; i++) c[i] = -series->depth[i];
        c[0] += m->layer < 0 ? 0.0L : k->layer[m->layer + 1].begin;
        if (first_zero(c, series->degree, *when, m->on == BELOW, &t)) *when = t, boundary = BELOW;
    }
    if (may_pull(k, m)) {
        for (int i = 0; i <= series->degree - 2; i++) c[i] = m->pressing ? series->value[i] : -series->value[i];
        if (first_zero(c, series->degree - 2, *when, m->on == SIGN, &t)) *when = t, boundary = SIGN;
    }
    return boundary;
}
