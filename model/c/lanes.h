/* Several instances of one program in step, one in each lane of the processor's vectors: the same operations in the same order
 * as in core.c, so the same digits. What differs between lanes is the length of internal steps, and whether one is done. */
#ifndef BRISTLE_LANES_H
#define BRISTLE_LANES_H

#include <math.h>

#include "core.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#if defined(LANES) /* chosen by whoever compiles; more than the processor's vectors hold take several of them */
#elif defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

typedef double Number __attribute__((vector_size(8 * LANES)));
typedef long long Mask __attribute__((vector_size(8 * LANES))); /* of a lane: all bits, or none */

#define ALL(x) ((x) - (Number){0.0}) /* a number that is the same in all lanes; less 0, which keeps the sign of a zero */
#define TRUE(x) (ALL(x) != 0)
#define KEPT(mask, x) ((Number)((Mask)(mask) & (Mask)ALL(x)))
#define ONE(mask) KEPT(mask, 1.0)
#define CHOSEN(mask, a, b) ((Number)(((Mask)(mask) & (Mask)ALL(a)) | (~(Mask)(mask) & (Mask)ALL(b))))
#define ANY(mask) any_lane((Mask)(mask))

static inline int any_lane(Mask mask)
{
    long long found = 0;
    for (int k = 0; k < LANES; k++) found |= mask[k];
    return found != 0;
}

#define EACH(name)                                             \
    static inline Number each_##name(Number x)                 \
    {                                                          \
        Number y;                                              \
        for (int k = 0; k < LANES; k++) y[k] = name(x[k]);     \
        return y;                                              \
    }
#define EACH_OF_TWO(name)                                      \
    static inline Number each_##name(Number a, Number b)       \
    {                                                          \
        Number y;                                              \
        for (int k = 0; k < LANES; k++) y[k] = name(a[k], b[k]); \
        return y;                                              \
    }
EACH(fabs) EACH(floor) EACH(ceil) EACH(sqrt) EACH(exp) EACH(log) EACH(sin) EACH(cos) EACH(tanh)
EACH_OF_TWO(atan2) EACH_OF_TWO(pow)

typedef void (*WideKernel)(Number *v, Number h, Number *out, Mask on);

/* The one variant of the program; places as of core.h. */
typedef struct {
    WideKernel derive, start, outputs, before, after, modes, step, step_jacobian, seen_jacobian; /* 0 where absent */
    int n_states, n_finite;
    const int *states, *finite;
    int sample_time, max_step, max_steps, friction_step;
} Wide;

extern const Wide WIDE;

typedef struct {
    Number v[N_V];
    Mask on;                     /* lanes that have not failed */
    double origin;
    Number shift;                /* how much later it is in a lane than the clock says that all share */
    Number *s;                   /* derivatives of the states by the chosen parameters, row-major, or 0 where none are wanted */
    long long ticks;
    long long level[LANES], left[LANES]; /* left: internal steps that this communication step may still take */
    double low[N_V], high[N_V];  /* of inputs */
    int n_inputs, inputs[N_V];
} Lanes;

void lanes_advance(Lanes *l, double now, double h);

#endif
