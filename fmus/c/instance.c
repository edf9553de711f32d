#include "instance.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define POINT_TOLERANCE 1e-6   /* of a step: how far a communication point may be from where the instance is */
#define TIME_ROUNDING 1e-13    /* relative: what adding up steps costs */
#define STATE_MAGIC "Bristle"

/* -- messages ---------------------------------------------------------------------------------------------------- */

/* The text is made of our own words, names of variables and numbers: it holds no % that a logger would expand. */
int refuse(const Instance *s, const char *who, const char *format, ...)
{
    char text[512];
    const int begun = snprintf(text, sizeof text, "%s: ", who);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text + begun, sizeof text - (size_t)begun, format, arguments);
    va_end(arguments);
    if (s->logging && s->logger) s->log(s, text);
    return ERROR;
}

static int refuse_array(const Instance *s, const char *who, size_t n)
{
    return refuse(s, who, "a NULL array where %lu values are announced", (unsigned long)n);
}

static const char *mode_name(int mode)
{
    switch (mode) {
    case INSTANTIATED: return "instantiated";
    case INITIALISATION: return "initialization mode";
    case EVENT: return "event mode";
    case CONTINUOUS: return "continuous-time mode";
    case STEP: return "step mode";
    case TERMINATED: return "terminated";
    default: return "failed (reset it, restore a state or free it)";
    }
}

static int require_mode(const Instance *s, const char *who, int modes)
{
    if (s->now.mode & modes) return OK;
    return refuse(s, who, "not allowed while the instance is %s", mode_name(s->now.mode));
}

static int require_pointer(const Instance *s, const char *who, const void *pointer)
{
    return pointer ? OK : refuse(s, who, "a NULL pointer where a value is needed");
}

/* The mode is right and the host gave a place for every result. */
int check_outputs(const Instance *s, const char *who, int modes, int n, const void *const pointers[])
{
    for (int i = 0; i < n; i++)
        if (require_pointer(s, who, pointers[i])) return ERROR;
    return require_mode(s, who, modes);
}

int set_logging(Instance *s, const char *who, int on, size_t n, const char *const categories[])
{
    if (n && !categories) return refuse_array(s, who, n);
    for (size_t i = 0; i < n; i++)
        if (!categories[i] || strcmp(categories[i], LOG_CATEGORY)) return refuse(s, who, "the only category is " LOG_CATEGORY);
    s->logging = on;
    return OK;
}

/* -- life -------------------------------------------------------------------------------------------------------- */

static void enter(Instance *s, int mode)
{
    s->now.mode = mode;
    s->settable = mode & (INSTANTIATED | INITIALISATION) ? SET_EARLY
                : mode & (EVENT | CONTINUOUS) ? SET_LATE | SET_STATE
                : mode & STEP ? SET_LATE : 0;
}

int instance_reset(Instance *s)
{
    const int kind = s->now.kind;
    memset(&s->now, 0, sizeof s->now);
    core_defaults(&s->now.core);
    s->now.kind = kind;
    s->now.stop = INFINITY;
    enter(s, INSTANTIATED);
    return OK;
}

static const char *objection(const Request *r)
{
    if (r->objection) return r->objection;
    if (!r->name || !*r->name) return "the instance needs a name";
    if (!r->token || strcmp(r->token, TOKEN)) return "the GUID or instantiation token is not that of this FMU: " TOKEN;
    if (r->kind == MODEL_EXCHANGE && !SMOOTH) return "this FMU offers no Model Exchange";
    return 0;
}

void *instance_create(const char *who, const Request *r)
{
    Instance *s = calloc(1, sizeof *s);
    if (!s) return 0;
    s->logging = r->logging;
    s->log = r->log;
    s->logger = r->logger;
    s->environment = r->environment;
    snprintf(s->name, sizeof s->name, "%s", r->name ? r->name : "");
    const char *problem = objection(r);
    void *handle = problem ? 0 : handle_make(s, HANDLE_INSTANCE);
    if (!handle) {
        refuse(s, who, "%s", problem ? problem : "too many instances at once");
        free(s);
        return 0;
    }
    s->now.kind = r->kind;
    instance_reset(s);
    return handle;
}

void instance_free(void *handle) { free(handle_drop(handle, HANDLE_INSTANCE)); }

/* -- values computed when they are asked for --------------------------------------------------------------------- */

/* Derivatives and outputs of a smooth model have no reason to be anything but finite; states from outside may be huge. */
static int refuse_infinite(const Instance *s, const char *who)
{
#if SMOOTH
    for (unsigned vr = 0; vr < N_V; vr++)
        if (ROW[vr] >= 0 && !(fabs(s->now.core.v[vr]) <= DBL_MAX))
            return refuse(s, who, "%s is not finite; the states or inputs are too large", NAME[vr]);
#else
    (void)s; (void)who;
#endif
    return OK;
}

/* Index and enumeration choose the same; one at its start value leaves the choice to the other. */
static int check_choice(const Instance *s, const char *who)
{
#if CHOICE
    const double chosen = s->now.core.v[SELECTOR], index = s->now.core.v[INDEX];
    if (!(index >= 0.0 && index <= N_VARIANTS))
        return refuse(s, who, "%s = %g is outside [0, %d]; 0: as %s says", NAME[INDEX], index, N_VARIANTS, NAME[SELECTOR]);
    if (index != 0.0 && chosen != START[SELECTOR] && chosen != index)
        return refuse(s, who, "%s = %g contradicts %s = %g; set one of the two", NAME[INDEX], index, NAME[SELECTOR], chosen);
#else
    (void)s; (void)who;
#endif
    return OK;
}

static int refresh(Instance *s, const char *who)
{
    if (!s->now.stale) return OK;
    if (s->now.stale & SET_EARLY) {
        if (check_choice(s, who)) return ERROR;
        const int code = core_initialise(&s->now.core, s->now.core.v[0]);
        if (code != CORE_OK) return refuse(s, who, "%s", core_message(code));
    } else {
        core_outputs(&s->now.core);
    }
    if (refuse_infinite(s, who)) return ERROR;
    s->now.stale = 0;
    return OK;
}

/* -- the state machine ------------------------------------------------------------------------------------------- */

int change_mode(Instance *s, const char *who, int from, int to)
{
    if (require_mode(s, who, from)) return ERROR;
    enter(s, to);
    return OK;
}

int set_experiment(Instance *s, const char *who, double start, int stop_defined, double stop)
{
    if (require_mode(s, who, INSTANTIATED)) return ERROR;
    if (!(fabs(start) <= DBL_MAX)) return refuse(s, who, "the start time must be finite");
    if (stop_defined && !(stop >= start && stop <= DBL_MAX))
        return refuse(s, who, "the stop time must be finite and not before the start");
    s->now.timed = 1;
    s->now.core.v[0] = start;
    s->now.stop = stop_defined ? stop : INFINITY;
    return OK;
}

int enter_initialisation(Instance *s, const char *who)
{
    if (require_mode(s, who, INSTANTIATED)) return ERROR;
    s->now.stale = SET_EARLY;
    enter(s, INITIALISATION);
    return OK;
}

int leave_initialisation(Instance *s, const char *who)
{
    if (require_mode(s, who, INITIALISATION)) return ERROR;
    if (refresh(s, who)) {
        enter(s, FAILED);
        return ERROR;
    }
    enter(s, s->now.kind == CO_SIMULATION ? STEP : EVENT);
    return OK;
}

int event_mode(Instance *s, const char *who)
{
    if (s->now.kind != MODEL_EXCHANGE) return refuse(s, who, "the instance was made for Co-Simulation and has no event mode");
    return change_mode(s, who, EVENT | CONTINUOUS, EVENT);
}

/* -- variables --------------------------------------------------------------------------------------------------- */

static int refuse_access(const Instance *s, const char *who, unsigned vr, unsigned type)
{
    if (vr >= N_V || !ACCESS[vr]) return refuse(s, who, "no variable has value reference %u", vr);
    if (!(ACCESS[vr] & type)) return refuse(s, who, "%s is of another type", NAME[vr]);
    if (!(ACCESS[vr] & (SET_EARLY | SET_LATE))) return refuse(s, who, "%s is computed and cannot be set", NAME[vr]);
    return refuse(s, who, "%s is a fixed parameter; set it before initialization ends", NAME[vr]);
}

static int refuse_value(const Instance *s, const char *who, unsigned vr, double value)
{
    if (!(fabs(value) <= DBL_MAX)) return refuse(s, who, "%s = %g: the value must be finite", NAME[vr], value);
    return refuse(s, who, "%s = %g is outside [%g, %g] %s", NAME[vr], value, LOW[vr], HIGH[vr], UNIT[vr]);
}

int begin_get(Instance *s, const char *who, const unsigned vr[], size_t n, const void *value)
{
    if (require_mode(s, who, COMPUTED)) return ERROR;
    if (n && (!vr || !value)) return refuse_array(s, who, n);
    return refresh(s, who);
}

int begin_set(Instance *s, const char *who, const unsigned vr[], size_t n, const void *value)
{
    if (!s->settable) return require_mode(s, who, 0);
    if (n && (!vr || !value)) return refuse_array(s, who, n);
    return OK;
}

static inline int readable(unsigned vr, unsigned type) { return vr < N_V && (ACCESS[vr] & type); }

static inline int writable(const Instance *s, unsigned vr, unsigned type)
{
    return vr < N_V && (ACCESS[vr] & type) && (ACCESS[vr] & s->settable);
}

/* False for NaN too; a variable without limits has the largest finite numbers for limits. */
static inline int in_range(unsigned vr, double value) { return value >= LOW[vr] && value <= HIGH[vr]; }

int get_one(Instance *s, const char *who, unsigned vr, unsigned type, double *value)
{
    if (!readable(vr, type)) return refuse_access(s, who, vr, type);
    *value = s->now.core.v[vr];
    return OK;
}

int check_one(const Instance *s, const char *who, unsigned vr, unsigned type, double value)
{
    if (!writable(s, vr, type)) return refuse_access(s, who, vr, type);
    return in_range(vr, value) ? OK : refuse_value(s, who, vr, value);
}

void assign(Instance *s, unsigned vr, double value)
{
    s->now.core.v[vr] = value;
    s->now.stale |= s->settable;
}

int no_variable(const Instance *s, const char *who, size_t n)
{
    return n ? refuse(s, who, "this FMU has no variable of this type") : OK;
}

int get_reals(Instance *s, const char *who, const unsigned vr[], size_t n, double value[])
{
    if ((!(s->now.mode & COMPUTED) || s->now.stale || !vr || !value) && begin_get(s, who, vr, n, value)) return ERROR;
    const double *v = s->now.core.v;
    for (size_t i = 0; i < n; i++) {
        if (!readable(vr[i], REAL)) return refuse_access(s, who, vr[i], REAL);
        value[i] = v[vr[i]];
    }
    return OK;
}

int set_reals(Instance *s, const char *who, const unsigned vr[], size_t n, const double value[])
{
    if ((!s->settable || !vr || !value) && begin_set(s, who, vr, n, value)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!writable(s, vr[i], REAL) || !in_range(vr[i], value[i])) return check_one(s, who, vr[i], REAL, value[i]);
    for (size_t i = 0; i < n; i++) assign(s, vr[i], value[i]);
    return OK;
}

/* -- co-simulation ----------------------------------------------------------------------------------------------- */

typedef struct {
    double time, origin, moving[N_V];
    long long ticks, steps;
    int level;
} Before; /* what a step changes, but for the outputs, which follow from it */

static void remember(Before *b, const Core *c)
{
    b->time = c->v[0]; b->origin = c->origin; b->ticks = c->ticks; b->steps = c->steps; b->level = c->level;
    memcpy(b->moving, c->v + MOVING[c->variant][0], sizeof(double) * (size_t)MOVING[c->variant][1]);
}

static void go_back(const Before *b, Core *c)
{
    c->v[0] = b->time; c->origin = b->origin; c->ticks = b->ticks; c->steps = b->steps; c->level = b->level;
    memcpy(c->v + MOVING[c->variant][0], b->moving, sizeof(double) * (size_t)MOVING[c->variant][1]);
}

static int check_step(const Instance *s, const char *who, double point, double h)
{
    const double time = s->now.core.v[0];
    if (require_mode(s, who, STEP)) return ERROR;
    if (!(h > 0.0 && h <= DBL_MAX)) return refuse(s, who, "the step size must be finite and greater than 0, not %g", h);
    if (!(fabs(point - time) <= POINT_TOLERANCE * h + TIME_ROUNDING * fabs(time)))
        return refuse(s, who, "the communication point is %.17g s, but the instance is at %.17g s", point, time);
    if (!(point + h > point)) return refuse(s, who, "the step size %g is too small to change the time %g", h, point);
    if (!(point + h <= s->now.stop + POINT_TOLERANCE * h + TIME_ROUNDING * fabs(time)))
        return refuse(s, who, "the step would go beyond the stop time %g", s->now.stop);
    return OK;
}

int instance_step(Instance *s, const char *who, double point, double h)
{
    Core *c = &s->now.core;
    Before before;
    if (check_step(s, who, point, h)) return ERROR;
    remember(&before, c);
    c->v[0] = point;
    const int code = core_advance(c, h);
    if (code != CORE_OK) {
        go_back(&before, c);
        s->now.stale = SET_LATE;
        enter(s, FAILED);
        return refuse(s, who, "%s (at %g s, step size %g s)", core_message(code), point, h);
    }
    s->now.stale = 0;
    return OK;
}

/* -- derivatives ------------------------------------------------------------------------------------------------- */

#if SMOOTH
static int refuse_direction(const Instance *s, const char *who, unsigned vr, const char *role)
{
    return vr < N_V && ACCESS[vr] ? refuse(s, who, "no derivative is available with %s as %s", NAME[vr], role)
                                  : refuse(s, who, "no variable has value reference %u", vr);
}

int directional_derivative(Instance *s, const char *who, const unsigned unknown[], size_t n_unknown,
                           const unsigned known[], size_t n_known, const double seed[], double sensitivity[])
{
    double jacobian[N_JACOBIAN];
    if (begin_get(s, who, unknown, n_unknown, sensitivity) || begin_get(s, who, known, n_known, seed)) return ERROR;
    for (size_t k = 0; k < n_known; k++) {
        if (known[k] >= N_V || COLUMN[known[k]] < 0) return refuse_direction(s, who, known[k], "known");
        if (!(fabs(seed[k]) <= DBL_MAX)) return refuse(s, who, "the seed of %s must be finite", NAME[known[k]]);
    }
    for (size_t i = 0; i < n_unknown; i++)
        if (unknown[i] >= N_V || ROW[unknown[i]] < 0) return refuse_direction(s, who, unknown[i], "unknown");
    core_jacobian(&s->now.core, jacobian);
    for (size_t i = 0; i < n_unknown; i++) {
        sensitivity[i] = 0.0;
        for (size_t k = 0; k < n_known; k++) sensitivity[i] += jacobian[ROW[unknown[i]] * N_KNOWN + COLUMN[known[k]]] * seed[k];
        if (!(fabs(sensitivity[i]) <= DBL_MAX)) return refuse(s, who, "the derivative of %s is not finite", NAME[unknown[i]]);
    }
    return OK;
}
#else
int directional_derivative(Instance *s, const char *who, const unsigned unknown[], size_t n_unknown,
                           const unsigned known[], size_t n_known, const double seed[], double sensitivity[])
{
    (void)unknown; (void)n_unknown; (void)known; (void)n_known; (void)seed; (void)sensitivity;
    return refuse(s, who, "this FMU provides no derivatives: its model is not smooth");
}
#endif

/* -- states of the whole instance -------------------------------------------------------------------------------- */

typedef struct {
    char magic[8], token[48];
    unsigned long long size, checksum;
} Header;

#define STATE_SIZE (sizeof(Header) + sizeof(Situation)) /* serialised */

static Situation *find_state(void *handle) { return handle_find(handle, HANDLE_STATE); }

static int refuse_state(const Instance *s, const char *who)
{
    return refuse(s, who, "this is no FMU state of this FMU (never made, already freed, or another FMU's)");
}

/* Copy a situation into the state behind *handle, which is made where the host has none yet. */
static int store_state(Instance *s, const char *who, const Situation *from, void **handle)
{
    Situation *state = *handle ? find_state(*handle) : calloc(1, sizeof *state);
    if (!state) return *handle ? refuse_state(s, who) : refuse(s, who, "out of memory");
    memcpy(state, from, sizeof *state);
    if (!*handle) *handle = handle_make(state, HANDLE_STATE);
    if (*handle) return OK;
    free(state);
    return refuse(s, who, "too many FMU states at once");
}

int state_get(Instance *s, const char *who, void **handle)
{
    return require_pointer(s, who, handle) ? ERROR : store_state(s, who, &s->now, handle);
}

int state_set(Instance *s, const char *who, void *handle)
{
    const Situation *state = find_state(handle);
    if (!state) return refuse_state(s, who);
    if (state->kind != s->now.kind) return refuse(s, who, "the state is of the other kind (Co-Simulation, Model Exchange)");
    memcpy(&s->now, state, sizeof s->now);
    enter(s, s->now.mode);
    return OK;
}

int state_free(Instance *s, const char *who, void **handle)
{
    if (require_pointer(s, who, handle)) return ERROR;
    if (!*handle) return OK;
    void *state = handle_drop(*handle, HANDLE_STATE);
    if (!state) return refuse_state(s, who);
    free(state);
    *handle = 0;
    return OK;
}

/* FNV-1a */
static unsigned long long checksum(const Situation *state)
{
    const unsigned char *byte = (const unsigned char *)state;
    unsigned long long sum = 0xcbf29ce484222325u;
    for (size_t i = 0; i < sizeof *state; i++) sum = (sum ^ byte[i]) * 0x100000001b3u;
    return sum;
}

static Header header_of(const Situation *state)
{
    Header header;
    memset(&header, 0, sizeof header);
    memcpy(header.magic, STATE_MAGIC, sizeof STATE_MAGIC);
    memcpy(header.token, TOKEN, sizeof TOKEN);
    header.size = sizeof *state;
    header.checksum = checksum(state);
    return header;
}

int state_size(Instance *s, const char *who, void *handle, size_t *size)
{
    if (require_pointer(s, who, size)) return ERROR;
    if (!find_state(handle)) return refuse_state(s, who);
    *size = STATE_SIZE;
    return OK;
}

int state_serialise(Instance *s, const char *who, void *handle, void *bytes, size_t size)
{
    const Situation *state = find_state(handle);
    if (require_pointer(s, who, bytes)) return ERROR;
    if (!state) return refuse_state(s, who);
    if (size != STATE_SIZE)
        return refuse(s, who, "the state has %lu bytes, not %lu", (unsigned long)STATE_SIZE, (unsigned long)size);
    const Header header = header_of(state);
    memcpy(bytes, &header, sizeof header);
    memcpy((char *)bytes + sizeof header, state, sizeof *state);
    return OK;
}

/* The few numbers that lead to functions and loops; the rest are values. */
static int plausible(const Situation *state)
{
    const Core *c = &state->core;
    const int mode = state->mode, one_mode = mode > 0 && mode <= FAILED && !(mode & (mode - 1));
    const int kind = state->kind == CO_SIMULATION || (SMOOTH && state->kind == MODEL_EXCHANGE);
    return one_mode && kind && c->variant >= 0 && c->variant < N_VARIANTS && c->level >= 0 && c->level < 62;
}

int state_deserialise(Instance *s, const char *who, const void *bytes, size_t size, void **handle)
{
    Situation state;
    if (require_pointer(s, who, bytes) || require_pointer(s, who, handle)) return ERROR;
    if (size != STATE_SIZE) return refuse(s, who, "the bytes are not a serialised state of this FMU: wrong size");
    memcpy(&state, (const char *)bytes + sizeof(Header), sizeof state);
    const Header expected = header_of(&state);
    if (memcmp(bytes, &expected, sizeof expected) || !plausible(&state))
        return refuse(s, who, "the bytes are not a serialised state of this FMU: of another FMU, or damaged");
    return store_state(s, who, &state, handle);
}

/* -- model exchange ---------------------------------------------------------------------------------------------- */

static const Variant *variant_of(const Instance *s) { return VARIANTS[s->now.core.variant]; }

static int require_states(const Instance *s, const char *who, const double x[], size_t n)
{
    if (s->now.kind != MODEL_EXCHANGE) return refuse(s, who, "the instance was made for Co-Simulation");
    if (n != (size_t)variant_of(s)->n_states)
        return refuse(s, who, "there are %d continuous states, not %lu", variant_of(s)->n_states, (unsigned long)n);
    return n && !x ? refuse_array(s, who, n) : OK;
}

int count_states(const Instance *s, const char *who, size_t *n)
{
    if (require_pointer(s, who, n)) return ERROR;
    if (s->now.kind != MODEL_EXCHANGE) return refuse(s, who, "the instance was made for Co-Simulation");
    *n = (size_t)variant_of(s)->n_states;
    return OK;
}

int set_time(Instance *s, const char *who, double time)
{
    if (require_mode(s, who, EVENT | CONTINUOUS)) return ERROR;
    if (!(fabs(time) <= DBL_MAX)) return refuse(s, who, "the time must be finite");
    s->now.core.v[0] = time;
    s->now.stale |= SET_LATE;
    return OK;
}

int set_states(Instance *s, const char *who, const double x[], size_t n)
{
    if (require_states(s, who, x, n) || require_mode(s, who, CONTINUOUS)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!(fabs(x[i]) <= DBL_MAX))
            return refuse(s, who, "%s = %g: a state must be finite", NAME[variant_of(s)->states[i]], x[i]);
    for (size_t i = 0; i < n; i++) s->now.core.v[variant_of(s)->states[i]] = x[i];
    s->now.stale |= SET_LATE;
    return OK;
}

static int copy_out(Instance *s, const char *who, const int *places, double x[], size_t n)
{
    if (require_states(s, who, x, n) || require_mode(s, who, COMPUTED) || refresh(s, who)) return ERROR;
    for (size_t i = 0; i < n; i++) x[i] = s->now.core.v[places[i]];
    return OK;
}

int get_states(Instance *s, const char *who, double x[], size_t n) { return copy_out(s, who, variant_of(s)->states, x, n); }

int get_derivatives(Instance *s, const char *who, double dx[], size_t n)
{
    if (copy_out(s, who, variant_of(s)->ders, dx, n)) return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!(fabs(dx[i]) <= DBL_MAX)) return refuse(s, who, "%s is not finite: the model diverged", NAME[variant_of(s)->ders[i]]);
    return OK;
}

int get_nominals(Instance *s, const char *who, double nominal[], size_t n)
{
    if (require_states(s, who, nominal, n) || require_mode(s, who, COMPUTED)) return ERROR;
    for (size_t i = 0; i < n; i++) nominal[i] = NOMINAL[variant_of(s)->states[i]];
    return OK;
}
