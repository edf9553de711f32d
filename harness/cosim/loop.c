/* Co-simulation over the functions of loaded FMUs. Jacobi: every unit sees the bus as it stood at the start of the step;
 * sequential (Gauss-Seidel): a unit sees what those before it have just published.
 * compiled.py holds the twins of these structures, loop.py the same loop through FMPy's calls; the two give the same digits. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef void (*Function)(void);
typedef int (*Set2)(void *, const unsigned *, size_t, const double *);
typedef int (*Get2)(void *, const unsigned *, size_t, double *);
typedef int (*SetFlag2)(void *, const unsigned *, size_t, const int *);
typedef int (*GetFlag2)(void *, const unsigned *, size_t, int *);
typedef int (*Step2)(void *, double, double, int);
typedef int (*Set3)(void *, const unsigned *, size_t, const double *, size_t);
typedef int (*Get3)(void *, const unsigned *, size_t, double *, size_t);
typedef int (*SetFlag3)(void *, const unsigned *, size_t, const bool *, size_t);
typedef int (*GetFlag3)(void *, const unsigned *, size_t, bool *, size_t);
typedef int (*Step3)(void *, double, double, bool, bool *, bool *, bool *, double *);

typedef struct {
    void *instance;
    Function set, get, set_flag, get_flag, step;
    int fmi, n_in, n_out, n_in_flags, n_out_flags;
    const unsigned *in_vr, *out_vr; /* numbers, then Booleans, which the bus carries as 0 and 1 */
    double *in, *out;
} LoopUnit;

typedef struct { const double *from; double *to; double factor; long long unit; } Link; /* factor between units of measurement; unit: that of `to` */
typedef struct { long long step; double *to; double value; } Event;
typedef struct { const LoopUnit *unit; unsigned vr; int boolean; double factor; } Flag; /* what is read only now and then */

typedef struct {
    const LoopUnit *units;
    const Link *links;
    const Event *events;            /* sorted by step */
    double *const *series_to;       /* row k of series is put on the bus at step k */
    const double *series;
    const double *const *taps;      /* row k of record is the bus at the start of step k, times factors; one lane after another */
    const double *factors;
    const long long *mean;          /* not 0: what is kept is the mean over the communication steps of a row; NULL: of none */
    double *record;
    volatile long long *control;    /* [0] steps done, [1] not 0: stop, [3] unit at work */
    long long next_event;
    long long n_units, n_links, n_events, n_series, n_taps;
    long long n_lanes;              /* runs in step, each with its own taps and its own block of the record */
    long long split, sequential;    /* communication steps a row; Gauss-Seidel in the order of the units */
    double h;                       /* time between two rows */
    double start;                   /* time of row 0 */
    long long failed_unit, failed_status, failed_call;
    const Flag *flags;
    double *looks;                  /* a row of flags each look, the first at the start */
    long long *look_rows;           /* at which row of the record that was */
    const long long *watched;       /* taps whose values must stay below `huge` */
    long long *diverged_lanes;      /* NULL: a value beyond it ends the run; otherwise it marks its lane */
    double huge;
    long long n_flags, n_watched, n_looks;
    long long every, steps;         /* rows between two looks, and in all: the last look is at the last row */
    long long seen;                 /* row up to which values were compared with `huge` */
    long long diverged_row, diverged_tap;
} Master;

enum { OK = 0, WARNING = 1, ERROR = 3 }; /* of both FMI 2 and FMI 3 */
enum { ALL = -1 };                       /* units */

static int set_flag(const LoopUnit *u, int place)
{
    const bool three = u->in[place] != 0.0;
    const int two = three;
    return u->fmi == 3 ? ((SetFlag3)u->set_flag)(u->instance, &u->in_vr[place], 1, &three, 1)
                       : ((SetFlag2)u->set_flag)(u->instance, &u->in_vr[place], 1, &two);
}

static int get_flag(const LoopUnit *u, unsigned vr, double *out)
{
    bool three = false;
    int two = 0;
    const int status = u->fmi == 3 ? ((GetFlag3)u->get_flag)(u->instance, &vr, 1, &three, 1)
                                   : ((GetFlag2)u->get_flag)(u->instance, &vr, 1, &two);
    *out = three || two;
    return status;
}

static int get_numbers(const LoopUnit *u, const unsigned *vr, size_t n, double *out)
{
    return u->fmi == 3 ? ((Get3)u->get)(u->instance, vr, n, out, n) : ((Get2)u->get)(u->instance, vr, n, out);
}

static int unit_set(const LoopUnit *u)
{
    int status = OK;
    if (u->n_in > 0)
        status = u->fmi == 3 ? ((Set3)u->set)(u->instance, u->in_vr, (size_t)u->n_in, u->in, (size_t)u->n_in)
                             : ((Set2)u->set)(u->instance, u->in_vr, (size_t)u->n_in, u->in);
    for (int i = 0; i < u->n_in_flags && status <= WARNING; i++) status = set_flag(u, u->n_in + i);
    return status;
}

static int unit_get(const LoopUnit *u, double *out)
{
    int status = OK;
    if (u->n_out > 0) status = get_numbers(u, u->out_vr, (size_t)u->n_out, out);
    for (int i = u->n_out; i < u->n_out + u->n_out_flags && status <= WARNING; i++) status = get_flag(u, u->out_vr[i], &out[i]);
    return status;
}

static int unit_step(const LoopUnit *u, double time, double h)
{
    bool event = false, terminate = false, early = false;
    double reached = time;
    if (u->fmi != 3) return ((Step2)u->step)(u->instance, time, h, 1);
    const int status = ((Step3)u->step)(u->instance, time, h, true, &event, &terminate, &early, &reached);
    return status > WARNING ? status : (terminate || early) ? ERROR : status;
}

static void write_row(const Master *m, long long row)
{
    for (long long lane = 0; lane < m->n_lanes; lane++) {
        double *out = m->record + (lane * (m->steps + 1) + row) * m->n_taps;
        const double *const *taps = m->taps + lane * m->n_taps;
        for (long long i = 0; i < m->n_taps; i++)
            if (!m->mean || !m->mean[i]) out[i] = *taps[i] * m->factors[i];
    }
}

/* Of one lane. */
static void add_means(const Master *m, long long row)
{
    double *out = m->record + row * m->n_taps;
    for (long long i = 0; i < m->n_taps; i++)
        if (m->mean[i]) out[i] += *m->taps[i] * m->factors[i] / (double)m->split;
}

/* Carry outputs over to the inputs of a unit, or of all. */
static void transfer(const Master *m, long long unit)
{
    for (long long i = 0; i < m->n_links; i++)
        if (unit == ALL || m->links[i].unit == unit) *m->links[i].to = *m->links[i].from * m->links[i].factor;
}

static int fail(Master *m, long long unit, long long call, int status)
{
    m->failed_unit = unit;
    m->failed_status = status;
    m->failed_call = call;
    return status;
}

/* Set the inputs of all units, do a step, read the outputs; returns the status of the unit that failed, if one did. */
static int step_all(Master *m, double time, double h)
{
    if (!m->sequential) transfer(m, ALL);
    for (long long i = 0; i < m->n_units; i++) {
        const LoopUnit *u = &m->units[i];
        long long call = 0; /* inputs, step, outputs */
        m->control[3] = i;
        if (m->sequential) transfer(m, i);
        int status = unit_set(u);
        if (status <= WARNING) call = 1, status = unit_step(u, time, h);
        if (status <= WARNING) call = 2, status = unit_get(u, u->out);
        if (status > WARNING) return fail(m, i, call, status);
    }
    return OK;
}

static int read_flag(const Flag *f, double *out)
{
    const int status = f->boolean ? get_flag(f->unit, f->vr, out) : get_numbers(f->unit, &f->vr, 1, out);
    *out *= f->factor;
    return status;
}

static int look(Master *m, long long row)
{
    double *out = m->looks + m->n_looks * m->n_flags;
    for (long long i = 0; i < m->n_flags; i++) {
        const int status = read_flag(&m->flags[i], &out[i]);
        if (status > WARNING) return fail(m, m->flags[i].unit - m->units, 2, status);
    }
    m->look_rows[m->n_looks++] = row;
    return OK;
}

/* Whether a watched value of the rows that were not seen yet, up to `row`, is beyond all bounds, and so ends the run. */
static bool diverged(Master *m, long long row)
{
    for (; m->seen < row; m->seen++)
        for (long long lane = 0; lane < m->n_lanes; lane++) {
            const double *seen = m->record + (lane * (m->steps + 1) + m->seen + 1) * m->n_taps;
            for (long long i = 0; i < m->n_watched; i++) {
                if (!(fabs(seen[m->watched[i]]) > m->huge)) continue;
                if (m->diverged_lanes) {
                    m->diverged_lanes[lane] = 1;
                    continue;
                }
                m->diverged_row = m->seen + 1;
                m->diverged_tap = m->watched[i];
                return true;
            }
        }
    return false;
}

/* Read all outputs and flags and write row 0 of the record. */
EXPORT int loop_start(Master *m)
{
    for (long long i = 0; i < m->n_units; i++) {
        const int status = unit_get(&m->units[i], m->units[i].out);
        if (status > WARNING) return fail(m, i, 2, status);
    }
    write_row(m, 0);
    return look(m, 0);
}

/* Rows first .. first + count - 1, each of `split` communication steps; returns how many were done. */
EXPORT long long loop_run(Master *m, long long first, long long count)
{
    const double h = m->h / (double)m->split;
    for (long long k = first; k < first + count; k++) {
        if (m->control[1]) return k - first;
        for (; m->next_event < m->n_events && m->events[m->next_event].step <= k; m->next_event++)
            *m->events[m->next_event].to = m->events[m->next_event].value;
        for (long long i = 0; i < m->n_series; i++) *m->series_to[i] = m->series[k * m->n_series + i];
        for (long long s = 0; s < m->split; s++) {
            if (step_all(m, m->start + (double)(k * m->split + s) * h, h) > WARNING) {
                diverged(m, k);
                return k - first;
            }
            if (m->mean) add_means(m, k + 1);
        }
        write_row(m, k + 1);
        m->control[0] = k + 1;
        if ((k + 1) % m->every == 0 || k + 1 == m->steps)
            if (diverged(m, k + 1) || look(m, k + 1) > WARNING) return k + 1 - first;
    }
    return count;
}

/* One FMI 2 instance over a recorded input, once for each set of parameters. */
typedef struct {
    Function reset, setup, enter, leave;
} Lifecycle;

static int begin(const LoopUnit *u, const Lifecycle *l, long long n, const unsigned *vr, const double *values)
{
    int status = ((int (*)(void *))l->reset)(u->instance);
    if (status <= WARNING) status = ((Set2)u->set)(u->instance, vr, (size_t)n, values);
    if (status <= WARNING) status = ((int (*)(void *, int, double, double, int, double))l->setup)(u->instance, 0, 0.0, 0.0, 0, 0.0);
    if (status <= WARNING) status = ((int (*)(void *))l->enter)(u->instance);
    if (status <= WARNING) status = ((int (*)(void *))l->leave)(u->instance);
    return status;
}

/* series is (steps, n_in), values (sets, n), record (sets, steps + 1, n_out); rows that could not be computed are NaN.
 * Returns the number of sets that ran to their end. */
EXPORT long long loop_drive(const LoopUnit *u, const Lifecycle *l, long long steps, double h, const double *series, long long sets,
                            long long n, const unsigned *vr, const double *values, double *record, volatile long long *control)
{
    long long good = 0;
    for (long long s = 0; s < sets; s++) {
        double *row = record + s * (steps + 1) * u->n_out;
        const double *const end = row + (steps + 1) * u->n_out;
        int status = begin(u, l, n, vr, values + s * n);
        if (status <= WARNING) status = unit_get(u, row);
        if (status <= WARNING) row += u->n_out;
        for (long long k = 0; k < steps && status <= WARNING && !control[1]; k++) {
            status = ((Set2)u->set)(u->instance, u->in_vr, (size_t)u->n_in, series + k * u->n_in);
            if (status <= WARNING) status = unit_step(u, (double)k * h, h);
            if (status <= WARNING) status = unit_get(u, row);
            if (status <= WARNING) row += u->n_out;
        }
        good += row == end;
        for (; row < end; row++) *row = (double)NAN;
    }
    return good;
}
