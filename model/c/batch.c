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
    const int width = VARIANTS[c->variant]->n_states * N_SENSITIVITIES;
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
