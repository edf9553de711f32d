#include "core.h"

#include <math.h>
#include <string.h>

void core_defaults(Core *c)
{
    memset(c, 0, sizeof *c);
    memcpy(c->v, START, sizeof c->v);
}

static const Variant *variant_of(const Core *c) { return VARIANTS[c->variant]; }

/* The index decides unless it is 0; that the two do not contradict each other is for the host's side to check. */
int core_derive(Core *c)
{
    const double number = !CHOICE ? 1.0 : c->v[INDEX] != 0.0 ? c->v[INDEX] : c->v[SELECTOR];
    if (!(number >= 1.0 && number <= N_VARIANTS)) {
        c->variant = 0;
        return CORE_VARIANT;
    }
    c->variant = (int)number - 1;
    if (CHOICE) c->v[RUNNING] = c->variant + 1;
    variant_of(c)->derive(c->v, 0.0, 0);
    return CORE_OK;
}

void core_outputs(Core *c)
{
    const Variant *a = variant_of(c);
    a->outputs(c->v, 0.0, 0);
    if (a->n_states && a->rates) {
        double dx[N_X + 1];
        a->rates(c->v, 0.0, dx);
        for (int i = 0; i < a->n_states; i++) c->v[a->ders[i]] = dx[i];
    }
}

static int finite_states(const Core *c)
{
    const Variant *a = variant_of(c);
    double sum = 0.0; /* x - x is 0 for a finite x and NaN otherwise */
    for (int i = 0; i < a->n_finite; i++) sum += c->v[a->finite[i]] - c->v[a->finite[i]];
    return sum == 0.0;
}

int core_initialise(Core *c, double time)
{
    const int code = core_derive(c);
    if (code != CORE_OK) return code;
    c->v[0] = c->origin = time;
    c->ticks = c->steps = 0;
    c->level = 0;
    variant_of(c)->start(c->v, 0.0, 0);
    core_outputs(c);
    return finite_states(c) ? CORE_OK : CORE_NONFINITE;
}

int core_rates(Core *c, double *dx)
{
    const Variant *a = variant_of(c);
    if (a->n_states && !a->rates) return CORE_VARIANT;
    if (a->n_states) a->rates(c->v, 0.0, dx);
    return CORE_OK;
}

int core_jacobian(Core *c, double *jacobian)
{
    if (!variant_of(c)->jacobian) return CORE_VARIANT;
    variant_of(c)->jacobian(c->v, 0.0, jacobian);
    return CORE_OK;
}

/* Carry derivatives over a step, and return where it leads. */
static void sensitivities(Core *c, double h, double *s, double *x)
{
#if N_SENSITIVITIES
    const Variant *a = variant_of(c);
    const int n = a->n_states, q = N_SENSITIVITIES;
    double jacobian[N_X * (N_X + N_SENSITIVITIES + 1) + 1], old[N_X * N_SENSITIVITIES + 1];
    a->step_jacobian(c->v, h, jacobian);
    memcpy(old, s, sizeof(double) * (size_t)(n * q));
    for (int i = 0; i < n; i++)
        for (int k = 0; k < q; k++) {
            double sum = jacobian[i * (n + q) + n + k];
            for (int j = 0; j < n; j++) sum += jacobian[i * (n + q) + j] * old[j * q + k];
            s[i * q + k] = sum;
        }
    for (int i = 0; i < n; i++) x[i] = jacobian[n * (n + q) + i];
#else
    (void)c; (void)h; (void)s; (void)x;
#endif
}

static void accept(Core *c, double time, const double *x)
{
    const Variant *a = variant_of(c);
    for (int i = 0; i < a->n_states; i++) c->v[a->states[i]] = x[i];
    c->v[0] = time;
    if (a->modes) a->modes(c->v, 0.0, 0);
}

/* One segment with constant inputs, cut into 2^level equal steps; the cut follows the error estimate. */
static int segment_controlled(Core *c, double begin, double length, long long *left, double *s)
{
    const Variant *a = variant_of(c);
    double x[N_X + 2];
    long long i = 0, n = 1LL << c->level;
    while (i < n) {
        const double h = length / (double)n;
        if (--*left < 0) return CORE_CAP;
        c->steps++;
        a->step(c->v, h, x);
        double error = x[a->n_states];
        if (!(error <= 1.0)) {
            do { /* the estimate is of order 4 in h: halving the step divides it by 16 */
                if (c->level >= MAX_LEVEL) return CORE_STIFF;
                c->level++; i *= 2; n *= 2; error *= 0.0625;
            } while (error > 1.0);
            continue;
        }
        if (s) sensitivities(c, h, s, x);
        i++;
        accept(c, begin + length * ((double)i / (double)n), x);
        if (error < 0.03125 && c->level > 0 && i % 2 == 0) {
            c->level--; i /= 2; n /= 2;
        }
    }
    return CORE_OK;
}

static int segment_fixed(Core *c, double begin, double length, long long *left, double *s)
{
    const Variant *a = variant_of(c);
    double x[N_X + 2];
    const double ratio = ceil(length / c->v[a->friction_step] - STEP_ROUNDING);
    if (!(ratio <= (double)*left)) return CORE_CAP;
    const long long n = ratio < 1.0 ? 1 : (long long)ratio;
    const double h = length / (double)n;
    for (long long i = 1; i <= n; i++) {
        if (s) sensitivities(c, h, s, x);
        else a->step(c->v, h, x);
        accept(c, begin + length * ((double)i / (double)n), x);
    }
    *left -= n;
    c->steps += n;
    return CORE_OK;
}

/* The length is given besides begin and end, so that the digits do not depend on how large the time is. */
static int integrate(Core *c, double begin, double end, double whole, long long *left, double *s)
{
    const Variant *a = variant_of(c);
    if (!a->n_states) {
        c->v[0] = end;
        return CORE_OK;
    }
    const double parts = ceil(whole / c->v[a->max_step] - STEP_ROUNDING);
    if (!(parts <= (double)*left)) return CORE_CAP;
    const long long n = parts < 1.0 ? 1 : (long long)parts;
    const double length = whole / (double)n;
    for (long long i = 0; i < n; i++) {
        const double from = begin + length * (double)i;
        const int code = a->friction_step >= 0 ? segment_fixed(c, from, length, left, s)
                                               : segment_controlled(c, from, length, left, s);
        if (code != CORE_OK) return code;
        if (!finite_states(c)) return CORE_NONFINITE;
    }
    c->v[0] = end;
    return CORE_OK;
}

static int advance(Core *c, double h, double *s)
{
    const Variant *a = variant_of(c);
    if (!(h > 0.0) || h - h != 0.0) return CORE_STEP;
    const double end = c->v[0] + h;
    long long left = a->max_steps >= 0 ? (long long)c->v[a->max_steps] : 1000000;
    if (a->sample_time < 0) {
        const int code = integrate(c, c->v[0], end, h, &left, s);
        if (code != CORE_OK) return code;
        core_outputs(c);
        return CORE_OK;
    }
    const double period = c->v[a->sample_time], same = SAME_INSTANT * fmin(period, h);
    if (!(h / period <= (double)left)) return CORE_CAP;
    const double begin = c->v[0];
    do {
        double tick = c->origin + period * (double)c->ticks;
        if (c->v[0] >= tick - same) {
            if (a->before) a->before(c->v, 0.0, 0);
            c->ticks++;
            tick = c->origin + period * (double)c->ticks;
        }
        const double stop = tick > end - same ? end : tick;
        const double whole = c->v[0] == begin && stop == end ? h : stop - c->v[0];
        const int code = integrate(c, c->v[0], stop, whole, &left, s);
        if (code != CORE_OK) return code;
        if (stop >= tick - same && a->after) a->after(c->v, 0.0, 0);
        if (--left < 0) return CORE_CAP;
    } while (c->v[0] < end - same);
    c->v[0] = end;
    core_outputs(c);
    return finite_states(c) ? CORE_OK : CORE_NONFINITE;
}

int core_advance(Core *c, double h) { return advance(c, h, 0); }

#if N_SENSITIVITIES
int core_advance_sensitive(Core *c, double h, double *s) { return advance(c, h, s); }
#endif

const char *core_message(int code)
{
    switch (code) {
    case CORE_OK: return "ok";
    case CORE_CAP: return "the communication step needs more internal steps than solver.max_steps allows; make it shorter";
    case CORE_NONFINITE: return "a state is no longer finite: the model diverged; check parameters and inputs";
    case CORE_STIFF: return "the internal step became too small for solver.tolerance; loosen it or check the inputs";
    case CORE_STEP: return "the communication step must be finite and greater than 0";
    case CORE_VARIANT: return "the selected variant does not exist or does not offer this";
    default: return "unknown error";
    }
}
