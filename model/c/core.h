/* The clockwork around the generated functions of model.c: sampling, internal steps, error control.
 * model/runtime.py is its twin in Python, statement for statement, lanes.c that for several instances at once; all give the
 * same digits. */
#ifndef BRISTLE_CORE_H
#define BRISTLE_CORE_H

#include "model.h" /* generated: N_V, N_X, N_VARIANTS, N_JACOBIAN, N_SENSITIVITIES, CHOICE, ... */

#define MAX_LEVEL 40          /* a segment is halved at most this often */
#define STEP_ROUNDING 1e-6    /* of an internal step: how much longer than asked it may be */
#define SAME_INSTANT 1e-3     /* of a sampling period or a shorter step: how far the sum of many steps may drift from the grid */

typedef void (*Kernel)(double *v, double h, double *out);

typedef struct {
    Kernel derive, start, outputs, before, after, modes, step, rates, jacobian, step_jacobian; /* 0 where absent */
    int n_states, n_finite;
    const int *states, *ders, *finite;                       /* places in v[] */
    int sample_time, max_step, max_steps, friction_step;     /* places in v[], or -1 */
} Variant;

typedef struct {
    double v[N_V];
    double origin;          /* time of the first sampling instant */
    long long ticks;        /* sampling instants whose `before` update has been done */
    long long steps;        /* internal steps taken since initialisation, rejected ones included */
    int level;              /* the last internal step was a 2^-level part of its segment */
    int variant;
} Core;

enum { CORE_OK, CORE_CAP, CORE_NONFINITE, CORE_STIFF, CORE_STEP, CORE_VARIANT };

extern const Variant *const VARIANTS[N_VARIANTS];
extern const double START[N_V];

void core_defaults(Core *c);
int core_derive(Core *c);
int core_initialise(Core *c, double time);
int core_advance(Core *c, double h);
void core_outputs(Core *c);
int core_rates(Core *c, double *dx);
int core_jacobian(Core *c, double *jacobian);
const char *core_message(int code);

#if N_SENSITIVITIES
/* As core_advance, and carries s = d(states)/d(chosen parameters), row-major, through the internal steps taken. */
int core_advance_sensitive(Core *c, double h, double *s);
#endif

#endif
