/* Whole simulations in one call, for use inside a process (no FMI). */
#include <math.h>

#include "core.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT int batch_size(void) { return (int)sizeof(Core); }
EXPORT int batch_initialise(Core *c, const double *v, double time)
{
    core_defaults(c);
    for (int i = 0; i < N_V; i++) c->v[i] = v[i];
    return core_initialise(c, time);
}
EXPORT void batch_read(const Core *c, double *v) { for (int i = 0; i < N_V; i++) v[i] = c->v[i]; }
EXPORT void batch_write(Core *c, const double *v) { for (int i = 0; i < N_V; i++) c->v[i] = v[i]; }
EXPORT int batch_advance(Core *c, double h) { return core_advance(c, h); }
EXPORT void batch_outputs(Core *c) { core_outputs(c); }
EXPORT long long batch_steps(const Core *c) { return c->steps; }
EXPORT int batch_rates(Core *c, double *dx) { return core_rates(c, dx); }
EXPORT int batch_jacobian(Core *c, double *jacobian) { return core_jacobian(c, jacobian); }
EXPORT const char *batch_message(int code) { return core_message(code); }

/* n communication steps; row k of inputs is held over step k; row k of record is what stands at its start (row n: at
 * the end). Returns the step that failed, or n; *code says why. sensitivities (n + 1, states, parameters) may be 0. */
EXPORT long long batch_run(Core *c, long long n, double h, int n_inputs, const int *inputs, const double *values,
                           int n_record, const int *recorded, double *record, double *sensitivities, int *code)
{
#if N_SENSITIVITIES
    double s[N_X * N_SENSITIVITIES + 1] = {0.0};
    const int width = VARIANTS[c->variant].n_states * N_SENSITIVITIES;
#endif
    *code = CORE_OK;
    for (long long k = 0;; k++) {
        for (int i = 0; i < n_record; i++) record[k * n_record + i] = c->v[recorded[i]];
#if N_SENSITIVITIES
        if (sensitivities)
            for (int i = 0; i < width; i++) sensitivities[k * width + i] = s[i];
#endif
        if (k == n) return n;
        for (int i = 0; i < n_inputs; i++) c->v[inputs[i]] = values[k * n_inputs + i];
#if N_SENSITIVITIES
        *code = sensitivities ? core_advance_sensitive(c, h, s) : core_advance(c, h);
#else
        (void)sensitivities;
        *code = core_advance(c, h);
#endif
        if (*code != CORE_OK) return k;
    }
}

#if N_OBSERVED
/* A record as a chain of segments. At the start of each, chosen states are set anew (position, velocity: `starts`,
 * n_segments x (n_set + n_loose)) and their followers move along; all other states carry on from the segment before. The
 * observed output and its derivatives by the chosen parameters are averaged over `width` steps.
 * set[i]: index among the states; column[i]: its start parameter among the sensitivities; leader[j]: place in set[] of
 * the state that state j follows, or -1. The first of the set is what the sensor shows: it starts such that the observed
 * output is the value given. State loose[i] starts by starts[n_set + i] less than state against[i] (loose_column[i]: the
 * parameter for that); where this is no number it carries on as a follower, and what it starts by is written there.
 * seen (n_segments, bins), sens (n_segments, bins, parameters) or 0;
 * good[k] = 0 where the simulation failed. Returns the number of segments that did not fail. */
EXPORT long long batch_segments(Core *c, long long n_segments, int bins, int width, double h, int n_inputs, const int *inputs,
                                const double *values, int n_set, const int *set, const int *column, const int *leader,
                                double *starts, int n_loose, const int *loose, const int *against, const int *loose_column,
                                int observed, double *seen, double *sens, unsigned char *good)
{
    enum { Q = N_SENSITIVITIES };
    const Variant *a = &VARIANTS[c->variant];
    const int n = a->n_states, n_starts = n_set + n_loose;
    double s[N_X * Q + 1] = {0.0}, jacobian[N_X + Q + 1], fresh[N_V];
    const long long length = (long long)bins * width;
    long long succeeded = 0;
    for (int i = 0; i < N_V; i++) fresh[i] = c->v[i];
    for (long long k = 0; k < n_segments; k++) {
        double old[N_X + 1], *start = starts + k * n_starts;
        for (int j = 0; j < n; j++) old[j] = c->v[a->states[j]];
        for (int i = 0; i < n_set; i++) {
            c->v[a->states[set[i]]] = start[i];
            for (int q = 0; q < Q; q++) s[set[i] * Q + q] = q == column[i];
        }
        for (int i = 0; i < 3; i++) { /* fixed point: the sensor shows nearly its state */
            core_outputs(c);
            c->v[a->states[set[0]]] += start[0] - c->v[observed];
        }
        for (int i = 0; i < n_set; i++)
            for (int j = 0; j < n; j++)
                if (j != set[i]) s[j * Q + column[i]] = 0.0; /* what the last start left behind is not this one's doing */
        a->seen_jacobian(c->v, 0.0, jacobian);
        for (int q = 0; q < Q; q++) {
            double shown = q == column[0] ? -1.0 : jacobian[n + q];
            for (int j = 0; j < n; j++)
                if (j != set[0]) shown += jacobian[j] * s[j * Q + q]; /* such as the place within a play */
            s[set[0] * Q + q] = -shown / jacobian[set[0]];
        }
        for (int j = 0; j < n; j++) {
            const int from = leader[j] >= 0 ? set[leader[j]] : -1;
            if (from < 0) continue;
            c->v[a->states[j]] += c->v[a->states[from]] - old[from];
            /* the far side of a play remembers its past sharply: its derivatives start anew with the segment */
            for (int q = 0; q < Q; q++) s[j * Q + q] = s[from * Q + q];
        }
        for (int i = 0; i < n_loose; i++) {
            const int j = loose[i], from = against[i];
            const double now = c->v[a->states[from]], apart = start[n_set + i];
            if (isnan(apart)) start[n_set + i] = now - c->v[a->states[j]];
            else c->v[a->states[j]] = now - apart;
            for (int q = 0; q < Q; q++) s[j * Q + q] = s[from * Q + q] - (q == loose_column[i]);
        }
        int code = CORE_OK;
        for (int b = 0; b < bins; b++) {
            double sum = 0.0, *row = sens ? sens + (k * bins + b) * Q : 0;
            for (int q = 0; row && q < Q; q++) row[q] = 0.0;
            for (int i = 0; i < width && code == CORE_OK; i++) {
                for (int m = 0; m < n_inputs; m++)
                    c->v[inputs[m]] = values[(k * length + (long long)b * width + i) * n_inputs + m];
                if (i == 0 && b == 0) core_outputs(c); /* the states were just set */
                sum += c->v[observed];
                if (row) {
                    a->seen_jacobian(c->v, 0.0, jacobian);
                    for (int q = 0; q < Q; q++) {
                        double d = jacobian[n + q];
                        for (int j = 0; j < n; j++) d += jacobian[j] * s[j * Q + q];
                        row[q] += d / width;
                    }
                }
                code = row ? core_advance_sensitive(c, h, s) : core_advance(c, h);
            }
            seen[k * bins + b] = sum / width;
        }
        good[k] = code == CORE_OK;
        succeeded += good[k];
        if (code != CORE_OK) { /* go on with fresh states; the clock keeps going */
            const double time = fresh[0] + h * (double)((k + 1) * length);
            for (int i = 0; i < N_V; i++) c->v[i] = fresh[i];
            core_initialise(c, time);
            for (int i = 0; i < n * Q; i++) s[i] = 0.0;
        }
    }
    return succeeded;
}
#endif
