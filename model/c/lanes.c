/* Time stepping of several lanes: core.c, with a mask where lanes part. A lane that fails is left where it is, for its run to be
 * made again alone; parameters of time (sample_time, solver.max_step, solver.max_steps, solver.friction_step) are equal in all. */
#include "lanes.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static double first(const Lanes *l, int place) { return l->v[place][0]; }

/* Lanes that may not take so many internal steps have failed. */
static void check_left(Lanes *l, double steps)
{
    for (int k = 0; k < LANES; k++)
        if (!(steps <= (double)l->left[k])) l->on[k] = 0;
}

static void check_finite(Lanes *l)
{
    Number sum = {0.0};
    for (int i = 0; i < WIDE.n_finite; i++) sum += l->v[WIDE.finite[i]] - l->v[WIDE.finite[i]];
    l->on &= sum == 0.0;
}

/* Carry derivatives over a step, and return where it leads. */
static void sensitivities(Lanes *l, Mask done, Number h, Number *x)
{
#if N_SENSITIVITIES
    const int n = WIDE.n_states, q = N_SENSITIVITIES;
    Number jacobian[N_X * (N_X + N_SENSITIVITIES + 1) + 1], old[N_X * N_SENSITIVITIES + 1];
    WIDE.step_jacobian(l->v, h, jacobian, done);
    memcpy(old, l->s, sizeof(Number) * (size_t)(n * q));
    for (int i = 0; i < n; i++)
        for (int k = 0; k < q; k++) {
            Number sum = jacobian[i * (n + q) + n + k];
            for (int j = 0; j < n; j++) sum += jacobian[i * (n + q) + j] * old[j * q + k];
            l->s[i * q + k] = CHOSEN(done, sum, old[i * q + k]);
        }
    for (int i = 0; i < n; i++) x[i] = CHOSEN(done, jacobian[n * (n + q) + i], x[i]);
#else
    (void)l; (void)done; (void)h; (void)x;
#endif
}

static void accept(Lanes *l, Mask done, Number time, const Number *x)
{
    for (int i = 0; i < WIDE.n_states; i++) l->v[WIDE.states[i]] = CHOSEN(done, x[i], l->v[WIDE.states[i]]);
    l->v[0] = CHOSEN(done, time + l->shift, l->v[0]);
    if (WIDE.modes) WIDE.modes(l->v, ALL(0.0), 0, done);
}

/* Judge the step of one lane by its error: 1 accepted, 0 repeated with a shorter one, -1 failed. */
static int judged(Lanes *l, int k, double error, long long *i, long long *n)
{
    if (error <= 1.0) {
        ++*i;
        return 1;
    }
    do {
        if (l->level[k] >= MAX_LEVEL) return -1;
        l->level[k]++; *i *= 2; *n *= 2; error *= 0.0625;
    } while (error > 1.0);
    return 0;
}

static void segment_controlled(Lanes *l, double begin, double length)
{
    Number x[N_X + 2] = {{0.0}}, h = {0.0}, time;
    Mask busy = l->on;
    long long i[LANES] = {0}, n[LANES];
    for (int k = 0; k < LANES; k++) n[k] = 1LL << l->level[k];
    while (ANY(busy)) {
        Mask done = {0};
        for (int k = 0; k < LANES; k++) h[k] = length / (double)n[k];
        WIDE.step(l->v, h, x, busy);
        for (int k = 0; k < LANES; k++) {
            if (!busy[k]) continue;
            const int found = --l->left[k] < 0 ? -1 : judged(l, k, x[WIDE.n_states][k], &i[k], &n[k]);
            if (found < 0) l->on[k] = busy[k] = 0;
            if (found <= 0) continue;
            done[k] = -1;
            time[k] = begin + length * ((double)i[k] / (double)n[k]);
        }
        if (l->s) sensitivities(l, done, h, x);
        accept(l, done, time, x);
        for (int k = 0; k < LANES; k++) {
            if (!done[k]) continue;
            if (x[WIDE.n_states][k] < 0.03125 && l->level[k] > 0 && i[k] % 2 == 0) l->level[k]--, i[k] /= 2, n[k] /= 2;
            if (i[k] >= n[k]) busy[k] = 0;
        }
    }
}

static void segment_fixed(Lanes *l, double begin, double length)
{
    Number x[N_X + 2] = {{0.0}};
    const double ratio = ceil(length / first(l, WIDE.friction_step) - STEP_ROUNDING);
    check_left(l, ratio);
    const long long n = !ANY(l->on) ? 0 : ratio < 1.0 ? 1 : (long long)ratio;
    for (long long i = 1; i <= n; i++) {
        if (l->s) sensitivities(l, l->on, ALL(length / (double)n), x);
        else WIDE.step(l->v, ALL(length / (double)n), x, l->on);
        accept(l, l->on, ALL(begin + length * ((double)i / (double)n)), x);
    }
    for (int k = 0; k < LANES; k++) l->left[k] -= n;
}

static void integrate(Lanes *l, double begin, double end, double whole)
{
    if (WIDE.n_states) {
        const double parts = ceil(whole / first(l, WIDE.max_step) - STEP_ROUNDING);
        check_left(l, parts);
        const long long n = !ANY(l->on) ? 0 : parts < 1.0 ? 1 : (long long)parts;
        const double length = whole / (double)n;
        for (long long i = 0; i < n; i++) {
            const double from = begin + length * (double)i;
            if (WIDE.friction_step >= 0) segment_fixed(l, from, length);
            else segment_controlled(l, from, length);
            check_finite(l);
        }
    }
    l->v[0] = ALL(end) + l->shift;
}

void lanes_advance(Lanes *l, double now, double h)
{
    const double end = now + h, period = WIDE.sample_time < 0 ? 0.0 : first(l, WIDE.sample_time);
    l->v[0] = ALL(now) + l->shift;
    for (int k = 0; k < LANES; k++) l->left[k] = WIDE.max_steps >= 0 ? (long long)first(l, WIDE.max_steps) : 1000000;
    if (WIDE.sample_time < 0) {
        integrate(l, now, end, h);
        WIDE.outputs(l->v, ALL(0.0), 0, l->on);
        return;
    }
    const double same = SAME_INSTANT * fmin(period, h), begin = now;
    check_left(l, h / period);
    do {
        double tick = l->origin + period * (double)l->ticks;
        if (now >= tick - same) {
            if (WIDE.before) WIDE.before(l->v, ALL(0.0), 0, l->on);
            l->ticks++;
            tick = l->origin + period * (double)l->ticks;
        }
        const double stop = tick > end - same ? end : tick;
        integrate(l, now, stop, now == begin && stop == end ? h : stop - now);
        now = stop;
        if (stop >= tick - same && WIDE.after) WIDE.after(l->v, ALL(0.0), 0, l->on);
        for (int k = 0; k < LANES; k++)
            if (--l->left[k] < 0) l->on[k] = 0;
    } while (now < end - same && ANY(l->on));
    l->v[0] = ALL(end) + l->shift;
    WIDE.outputs(l->v, ALL(0.0), 0, l->on);
    check_finite(l);
}

EXPORT int lanes_width(void) { return LANES; }
EXPORT int lanes_size(void) { return (int)sizeof(Lanes); }

/* Set all lanes to the start of values (N_V x LANES); low, high: limits of those inputs that will be driven. */
EXPORT void lanes_initialise(Lanes *l, const double *values, double time, int n_inputs, const int *inputs, const double *low,
                             const double *high)
{
    memset(l, 0, sizeof *l);
    memcpy(l->v, values, sizeof l->v);
    l->on = ~(Mask){0};
    l->v[0] = ALL(time);
    l->origin = time;
    l->n_inputs = n_inputs;
    for (int i = 0; i < n_inputs; i++) l->inputs[i] = inputs[i], l->low[i] = low[i], l->high[i] = high[i];
    WIDE.derive(l->v, ALL(0.0), 0, l->on);
    WIDE.start(l->v, ALL(0.0), 0, l->on);
    WIDE.outputs(l->v, ALL(0.0), 0, l->on);
    check_finite(l);
}

/* As fmi2DoStep and fmi2GetReal, for harness/cosim/loop.c; a reference is place * LANES + lane. A lane fails by itself: never the call. */
EXPORT int lanes_step(Lanes *l, double time, double h, int again)
{
    (void)again;
    for (int i = 0; i < l->n_inputs; i++) {
        const Number x = l->v[l->inputs[i]];
        l->on &= (x >= l->low[i]) & (x <= l->high[i]);
    }
    if (ANY(l->on)) lanes_advance(l, time, h);
    return 0;
}

EXPORT int lanes_get(const Lanes *l, const unsigned *references, size_t n, double *out)
{
    for (size_t i = 0; i < n; i++) out[i] = l->v[references[i] / LANES][references[i] % LANES];
    return 0;
}

EXPORT int lanes_alive(const Lanes *l, int lane) { return l->on[lane] != 0; }
