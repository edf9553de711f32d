/* Records as chains of segments, one chain in each lane. */
#include "lanes.h"

#include <math.h>
#include <string.h>

enum { Q = N_SENSITIVITIES };

/* How a segment begins. Chosen states are set anew (position, velocity) and their followers move along; all other states carry on
 * from the segment before. set[i]: index among the states; column[i]: its start parameter among the sensitivities; leader[j]: place
 * in set[] of the state that state j follows, or -1. The first of the set is what the sensor shows: it starts such that the
 * observed output is the value given. State loose[i] starts by so much less than state against[i] as is given behind the set
 * (loose_column[i]: the parameter for that), or carries on as a follower where that is no number. */
typedef struct {
    int n_set;
    const int *set, *column, *leader;
    int n_loose;
    const int *loose, *against, *loose_column;
    int observed; /* place of the output */
} Beginning;

static Number *state(Lanes *l, int j) { return &l->v[WIDE.states[j]]; }

/* Set the states, from start[] (n_set + n_loose), of those lanes that are on; where a loose one carries on, what it starts by is put
 * there. */
static void set_states(Lanes *l, const Beginning *g, Number *start)
{
    const Mask on = l->on;
    Number old[N_X + 1];
    for (int j = 0; j < WIDE.n_states; j++) old[j] = *state(l, j);
    for (int i = 0; i < g->n_set; i++) *state(l, g->set[i]) = CHOSEN(on, start[i], old[g->set[i]]);
    for (int i = 0; i < 3; i++) { /* fixed point: the sensor shows nearly its state */
        WIDE.outputs(l->v, ALL(0.0), 0, on);
        *state(l, g->set[0]) += KEPT(on, start[0] - l->v[g->observed]);
    }
    for (int j = 0; j < WIDE.n_states; j++) {
        if (g->leader[j] < 0) continue;
        const int from = g->set[g->leader[j]];
        *state(l, j) += KEPT(on, *state(l, from) - old[from]);
    }
    for (int i = 0; i < g->n_loose; i++) {
        const Number now = *state(l, g->against[i]), apart = start[g->n_set + i];
        Number *loose = state(l, g->loose[i]);
        start[g->n_set + i] = CHOSEN(apart == apart, apart, now - *loose);
        *loose = CHOSEN(on & (apart == apart), now - apart, *loose);
    }
}

/* Set the derivatives of the states to those by the starts; what carries on keeps its own by the parameters. */
static void set_derivatives(Lanes *l, const Beginning *g)
{
    const int n = WIDE.n_states;
    Number jacobian[N_X + Q + 1], *s = l->s;
    for (int i = 0; i < g->n_set; i++) {
        for (int q = 0; q < Q; q++) s[g->set[i] * Q + q] = ALL(q == g->column[i] ? 1.0 : 0.0);
        for (int j = 0; j < n; j++) /* what the last start left behind is not this one's doing */
            if (j != g->set[i]) s[j * Q + g->column[i]] = ALL(0.0);
    }
    WIDE.seen_jacobian(l->v, ALL(0.0), jacobian, ~(Mask){0});
    for (int q = 0; q < Q; q++) {
        Number shown = q == g->column[0] ? ALL(-1.0) : jacobian[n + q];
        for (int j = 0; j < n; j++)
            if (j != g->set[0]) shown += jacobian[j] * s[j * Q + q]; /* such as the place within a play */
        s[g->set[0] * Q + q] = -shown / jacobian[g->set[0]];
    }
    for (int j = 0; j < n; j++) /* the far side of a play remembers its past sharply: it starts anew */
        for (int q = 0; g->leader[j] >= 0 && q < Q; q++) s[j * Q + q] = s[g->set[g->leader[j]] * Q + q];
    for (int i = 0; i < g->n_loose; i++)
        for (int q = 0; q < Q; q++)
            s[g->loose[i] * Q + q] = s[g->against[i] * Q + q] - ALL(q == g->loose_column[i] ? 1.0 : 0.0);
}

static void add_shown(Lanes *l, double width, Number *row)
{
    const int n = WIDE.n_states;
    Number jacobian[N_X + Q + 1];
    WIDE.seen_jacobian(l->v, ALL(0.0), jacobian, ~(Mask){0});
    for (int q = 0; q < Q; q++) {
        Number d = jacobian[n + q];
        for (int j = 0; j < n; j++) d += jacobian[j] * l->s[j * Q + q];
        row[q] += d / width;
    }
}

/* Simulate segments of bins averages over width steps of length h, in lane k from first[k] to end[k] and from its time times[k] on.
 * What stands before begin[k] only leads the hidden states in, and writes nothing. A lane whose simulation fails goes on with fresh
 * states in the next segment. The lanes have been initialised. For all segments: values of the inputs, one after the other (bins * width
 * a segment, `total` an input), starts (n_set + n_loose), seen (bins), sens (bins, Q) or 0, good. */
EXPORT void lanes_segments(Lanes *l, const double *times, const long long *first, const long long *begin, const long long *end,
                           int bins, int width, double h, int n_inputs, const int *inputs,
                           const double *values, long long total, int n_set, const int *set,
                           const int *column, const int *leader, double *starts, int n_loose, const int *loose,
                           const int *against, const int *loose_column, int observed, double *seen, double *sens,
                           unsigned char *good)
{
    const Beginning how = {n_set, set, column, leader, n_loose, loose, against, loose_column, observed};
    const int n_starts = n_set + n_loose;
    const long long length = (long long)bins * width;
    Number s[N_X * Q + 1] = {{0.0}}, row[Q], start[N_X + 1], fresh[N_V];
    long long rows = 0;
    memcpy(fresh, l->v, sizeof fresh);
    l->s = sens ? s : 0;
    for (int k = 0; k < LANES; k++) {
        l->shift[k] = times[k];
        if (end[k] - first[k] > rows) rows = end[k] - first[k];
    }
    for (long long r = 0; r < rows; r++) {
        long long at[LANES], write[LANES];
        Mask running = {0}, failed = ~l->on;
        for (int k = 0; k < LANES; k++) {
            const int on = first[k] + r < end[k];
            at[k] = on ? first[k] + r : end[k] ? end[k] - 1 : 0; /* a lane that is done repeats its last segment, for nothing */
            running[k] = -on;
            write[k] = on && at[k] >= begin[k];
            for (int i = 0; i < n_starts; i++) start[i][k] = starts[at[k] * n_starts + i];
        }
        if (r > 0)
            for (int i = 0; i < N_V; i++) l->v[i] = CHOSEN(failed, fresh[i], l->v[i]);
        for (int i = 0; i < WIDE.n_states * Q; i++) s[i] = CHOSEN(failed, ALL(0.0), s[i]);
        for (int k = 0; k < LANES; k++)
            if (failed[k]) l->level[k] = 0;
        l->on = running;
        l->v[0] = ALL(h * (double)(r * length)) + l->shift;
        set_states(l, &how, start);
        if (sens) set_derivatives(l, &how);
        for (int k = 0; k < LANES; k++)
            for (int i = n_set; write[k] && i < n_starts; i++) starts[at[k] * n_starts + i] = start[i][k];
        for (int b = 0; b < bins; b++) {
            Number sum = {0.0};
            for (int q = 0; q < Q; q++) row[q] = ALL(0.0);
            for (long long i = (long long)b * width; i < (long long)(b + 1) * width; i++) {
                for (int j = 0; j < n_inputs; j++)
                    for (int k = 0; k < LANES; k++) l->v[inputs[j]][k] = values[j * total + at[k] * length + i];
                if (i == 0) WIDE.outputs(l->v, ALL(0.0), 0, l->on); /* the states were just set */
                sum += l->v[observed];
                if (sens) add_shown(l, width, row);
                if (ANY(l->on)) lanes_advance(l, h * (double)(r * length + i), h);
            }
            for (int k = 0; k < LANES; k++) {
                if (!write[k]) continue;
                seen[at[k] * bins + b] = (sum / (double)width)[k];
                for (int q = 0; sens && q < Q; q++) sens[(at[k] * bins + b) * Q + q] = row[q][k];
            }
        }
        for (int k = 0; k < LANES; k++)
            if (write[k]) good[at[k]] = l->on[k] != 0;
    }
}
