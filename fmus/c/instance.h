/* What FMI 2 and FMI 3 have in common: one instance, its state machine, and every operation on it.
 * The operations return OK or ERROR, which are the same numbers in both standards; whoever calls them has looked up the
 * instance. A refused call changes nothing and says why in one message. */
#ifndef BRISTLE_INSTANCE_H
#define BRISTLE_INSTANCE_H

#include <stddef.h>

#include "core.h"
#include "handles.h"
#include "interface.h" /* generated: tables of the variables */

enum { OK = 0, ERROR = 3 };
enum { CO_SIMULATION, MODEL_EXCHANGE };
enum {
    INSTANTIATED = 1, INITIALISATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32, FAILED = 64,
    COMPUTED = INITIALISATION | EVENT | CONTINUOUS | STEP | TERMINATED | FAILED /* modes in which values can be read */
};

typedef struct {
    Core core;
    double stop;      /* no step goes beyond this time */
    int kind, mode;
    int timed;        /* the experiment's times are set */
    unsigned stale;   /* SET_EARLY: the start must be computed again; SET_LATE: outputs and derivatives must be */
} Situation;          /* all that an FMU state has to hold */

typedef struct Instance Instance;
struct Instance {
    Situation now;
    unsigned settable; /* SET_EARLY, SET_LATE (with SET_STATE in Model Exchange) or 0: what may be set in this mode */
    int logging;
    void (*log)(const Instance *s, const char *message);
    void (*logger)(void); /* the host's function, called by `log` */
    void *environment;
    char name[64];
};

typedef struct {
    int kind, logging;
    const char *name, *token;
    void (*log)(const Instance *s, const char *message);
    void (*logger)(void);
    void *environment;
    const char *objection; /* of the standard's own wrapper, or 0 */
} Request;

#define LOG_CATEGORY "logStatusError"

static inline Instance *instance_find(void *handle) { return handle_find(handle, HANDLE_INSTANCE); }

void *instance_create(const char *who, const Request *request);
void instance_free(void *handle);
int refuse(const Instance *s, const char *who, const char *format, ...);
int set_logging(Instance *s, const char *who, int on, size_t n, const char *const categories[]);

int set_experiment(Instance *s, const char *who, double start, int stop_defined, double stop);
int enter_initialisation(Instance *s, const char *who);
int leave_initialisation(Instance *s, const char *who);
int change_mode(Instance *s, const char *who, int from, int to);
int event_mode(Instance *s, const char *who);
int check_outputs(const Instance *s, const char *who, int modes, int n, const void *const pointers[]);
int instance_reset(Instance *s);

int get_reals(Instance *s, const char *who, const unsigned vr[], size_t n, double value[]);
int set_reals(Instance *s, const char *who, const unsigned vr[], size_t n, const double value[]);
/* For the other types: the call as a whole, then value after value. */
int begin_get(Instance *s, const char *who, const unsigned vr[], size_t n, const void *value);
int begin_set(Instance *s, const char *who, const unsigned vr[], size_t n, const void *value);
int get_one(Instance *s, const char *who, unsigned vr, unsigned type, double *value);
int check_one(const Instance *s, const char *who, unsigned vr, unsigned type, double value);
void assign(Instance *s, unsigned vr, double value); /* what check_one has let pass */
int no_variable(const Instance *s, const char *who, size_t n);

int instance_step(Instance *s, const char *who, double point, double h);
int directional_derivative(Instance *s, const char *who, const unsigned unknown[], size_t n_unknown,
                           const unsigned known[], size_t n_known, const double seed[], double sensitivity[]);

int state_get(Instance *s, const char *who, void **handle);
int state_set(Instance *s, const char *who, void *handle);
int state_free(Instance *s, const char *who, void **handle);
int state_size(Instance *s, const char *who, void *handle, size_t *size);
int state_serialise(Instance *s, const char *who, void *handle, void *bytes, size_t size);
int state_deserialise(Instance *s, const char *who, const void *bytes, size_t size, void **handle);

/* Model exchange. */
int count_states(const Instance *s, const char *who, size_t *n);
int set_time(Instance *s, const char *who, double time);
int set_states(Instance *s, const char *who, const double x[], size_t n);
int get_states(Instance *s, const char *who, double x[], size_t n);
int get_derivatives(Instance *s, const char *who, double dx[], size_t n);
int get_nominals(Instance *s, const char *who, double nominal[], size_t n);

#endif
