/* A good FMU of v' = 1 + k u - v and w = k v + u, for FMI 2 or 3, Co-Simulation (exact over a step) and Model Exchange. What is wrong
 * with it is in the environment. Functions that are missing here are added as stubs that return an error. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define E __attribute__((visibility("default")))
#define JOIN(a, b) a##b
#if FMI == 2
#define F(name) E int JOIN(fmi2, name)
#define COUNT
typedef int Bool;
typedef int Integer;
#else
#define F(name) E int JOIN(fmi3, name)
#define COUNT , size_t count
typedef bool Bool;
typedef int64_t Integer;
#endif

enum { OK = 0, ERROR = 3 };
enum { TIME, U, K, V, DV, W, Q, Z, N };              /* real variables */
enum { I = 10, S = 11, B = 12 };                     /* an integer, a text, a Boolean */
enum { NEW, INITIAL, EVENT, CONTINUOUS, STEP, END }; /* modes */
typedef unsigned Vr;

typedef struct {
    double v[N], h;
    Integer i;
    Bool b;
    int mode, exchange, steps, asked, sets;
} Data;
typedef struct {
    Data d;
    int log, restored;
    void (*logger)(void);
    void *environment;
    char *lost;
} M;
typedef struct { Data d; int dead; } State;

static double shared, kept;
static int lives;
static Data table[64];
static int rows;

static int is(const char *what)
{
    const char *given = getenv("MUTANT");
    return given && !strcmp(given, what);
}

__attribute__((constructor)) static void loaded(void)
{
    if (!is("reload")) return;
    if (getenv("MUTANT_LOADED")) lives = 1;
    setenv("MUTANT_LOADED", "1", 1);
}
__attribute__((destructor)) static void unloaded(void)
{
    if (is("unload")) abort();
}

static void say(M *m, int status, const char *category, const char *text)
{
    if (!m->logger) {
        if (is("nulllog")) abort();
        return;
    }
    if (!m->log && status == OK) return;
    if (is("logcategory")) category = "other";
#if FMI == 2
    ((void (*)(void *, const char *, int, const char *, const char *, ...))m->logger)(m->environment, "one", status, category, text);
#else
    ((void (*)(void *, int, const char *, const char *))m->logger)(m->environment, status, category, text);
#endif
}
static int refuse(M *m, const char *text)
{
    say(m, ERROR, "logStatusError", text);
    return ERROR;
}

/* -- the model -------------------------------------------------------------------------------------------------------- */

static double slope(M *m)
{
    double a = 1.0 + m->d.v[K] * m->d.v[U] - m->d.v[V];
    if (is("exchangehalf") && m->d.exchange) a /= 2;
    if (is("exchangenan") && m->d.exchange && m->d.v[V] > 5e-4) a = NAN;
    if (is("exchangeq") && m->d.exchange) a += m->d.v[Q];
    if (is("impure")) a += 1e-9 * m->d.asked++;
    return a;
}
static double output(M *m)
{
    double w = m->d.v[K] * m->d.v[V] + m->d.v[U];
    if (is("initialq") && m->d.mode == INITIAL) w += m->d.v[Q];
    if (is("stepq") && m->d.mode == STEP) w += m->d.v[Q];
    if (is("range")) w += 1000;
    if (is("nan") && m->d.v[V] > 5e-3) w = NAN;
    if (is("latenan") && m->d.v[TIME] > 0.5) w = NAN;
    if (is("large")) w += 0 * exp(fabs(m->d.v[Q]));
    if (is("shared")) w += shared;
    return w;
}
static void start(M *m)
{
    double u = m->d.v[U], v = m->d.v[V], k = m->d.v[K];
    int exchange = m->d.exchange;
    memset(&m->d, 0, sizeof m->d);
    m->d.exchange = exchange;
    m->d.v[K] = is("start") ? 3.0 : is("resetparameter") && k ? k : 2.0;
    if (is("sharedparameter")) kept = 0;
    m->d.i = is("startinteger") ? 4 : 3;
    m->d.b = true;
    if (is("resetinput")) m->d.v[U] = u;
    if (is("reset") || (is("exchangereset") && exchange)) m->d.v[V] = v;
    if (is("again")) m->d.v[V] = 1e-3 * lives;
    if (is("reload")) m->d.v[V] = 1e-3 * (lives > 0);
    else lives++;
}
static void *sleeper(void *what)
{
    for (;;) pause();
    return what;
}
static void ignore(int number) { (void)number; }

static M *make(const char *name, const char *token, const char *resources, int log, int exchange, void (*logger)(void), void *environment)
{
    if (!name || !*name) {
        if (is("name")) abort();
        return NULL;
    }
    if ((!token || strcmp(token, "{good}")) && !is("token")) return NULL;
    if (is("folder") && resources && (strchr(resources, ' ') || strchr(resources, '%'))) return NULL;
    M *m = calloc(1, sizeof *m);
    m->d.exchange = exchange, m->log = log || is("logoff"), m->logger = logger, m->environment = environment;
    start(m);
    if (is("leakword")) m->lost = malloc(64);
    if (is("leakinstance")) m->lost = memset(malloc(1 << 20), 1, 1 << 20);
    if (is("handles") && open("/dev/null", O_RDONLY) < 0) return NULL;
    if (is("startthread")) {
        pthread_t thread;
        pthread_create(&thread, NULL, sleeper, NULL);
    }
    if (is("chdir") && chdir("/")) return NULL;
    if (is("rounding")) fesetround(FE_UPWARD);
    if (is("signal")) signal(SIGUSR2, ignore);
    if (is("mask")) umask(0);
    if (is("file")) fclose(fopen("mutant.log", "w"));
    if (is("ownfile") && resources) {
        char path[4096];
        snprintf(path, sizeof path, "%s/mutant.log", strncmp(resources, "file://", 7) ? resources : resources + 7);
        FILE *file = fopen(path, "w");
        if (file) fclose(file);
    }
    if (is("uninitialised")) m->lost = malloc(1 << 20), m->d.v[V] += 1e-3 * (m->lost[1 << 19] != 0);
    say(m, OK, "logAll", "made");
    if (is("nulllog")) say(m, OK, "logAll", "made");
    return m;
}

#if FMI == 2
typedef struct { void (*logger)(void); void *allocate, *free, *finished, *environment; } Callbacks;
E const char *fmi2GetTypesPlatform(void) { return is("platform") ? "other" : "default"; }
E const char *fmi2GetVersion(void) { return is("version") ? "1.0" : "2.0"; }
E M *fmi2Instantiate(const char *n, int kind, const char *token, const char *r, const Callbacks *c, int visible, int log)
{
    (void)visible;
    return make(n, token, r, log, kind == 0, c->logger, c->environment);
}
E void fmi2FreeInstance(M *m)
#else
E const char *fmi3GetVersion(void) { return is("version") ? "1.0" : "3.0"; }
E M *fmi3InstantiateModelExchange(const char *n, const char *token, const char *r, bool visible, bool log, void *e, void (*logger)(void))
{
    (void)visible;
    return make(n, token, r, log, 1, logger, e);
}
E M *fmi3InstantiateCoSimulation(const char *n, const char *token, const char *r, bool visible, bool log, bool event, bool early,
    const Vr *vr, size_t nvr, void *e, void (*logger)(void), void *update)
{
    (void)visible, (void)event, (void)early, (void)vr, (void)nvr, (void)update;
    M *m = is("noevents") && event ? NULL : make(n, token, r, log, 0, logger, e);
    if (m) m->d.sets = event ? -1 : 0; /* event mode is used */
    return m;
}
E void fmi3FreeInstance(M *m)
#endif
{
    if (!m && is("nullfree")) abort();
    if (m && m->d.mode == NEW && is("freenew")) abort();
    free(m);
}

/* -- life ------------------------------------------------------------------------------------------------------------- */

static int enter(M *m, double time)
{
    if (m->d.mode != NEW && !is("twice")) return refuse(m, "initialisation is under way");
    if (is("later") && time != 0) return refuse(m, "time is zero");
    m->d.v[TIME] = time;
    m->d.mode = INITIAL;
    return OK;
}
#if FMI == 2
F(SetupExperiment)(M *m, int td, double t, double begin, int ed, double end)
{
    (void)td, (void)t, (void)ed, (void)end;
    m->d.v[TIME] = begin;
    return OK;
}
F(EnterInitializationMode)(M *m) { return enter(m, m->d.v[TIME]); }
#else
F(EnterInitializationMode)(M *m, bool td, double t, double begin, bool ed, double end)
{
    (void)td, (void)t, (void)ed, (void)end;
    return enter(m, begin);
}
#endif
F(ExitInitializationMode)(M *m)
{
    if (m->d.mode != INITIAL && !is("exit")) return refuse(m, "not in initialisation");
    m->d.mode = m->d.exchange || m->d.sets < 0 ? EVENT : STEP;
    return OK;
}
F(Terminate)(M *m)
{
    m->d.mode = END;
    return OK;
}
F(Reset)(M *m)
{
    if (is("resetearly") && m->d.mode == INITIAL) return refuse(m, "not now");
    if (is("leak")) m->lost = memset(malloc(1 << 20), 1, 1 << 20);
    if (is("stateafter")) kept = -1;
    start(m);
    return OK;
}
F(SetDebugLogging)(M *m, Bool on, size_t n, const char *const *names)
{
    (void)names;
    if (is("logset") && n) return refuse(m, "no categories");
    m->log = on;
    return OK;
}

/* -- values ----------------------------------------------------------------------------------------------------------- */

static int set_one(M *m, Vr vr, double x)
{
    if (!isfinite(x) && !is("naninput")) return refuse(m, "no finite number");
    if (vr >= N && is("unknown")) return OK;
    if (vr == U || vr == Q) {
        if (is("unset") && m->d.mode == STEP) return refuse(m, "not now");
        if (vr == U && (x < -10 || x > 10)) return refuse(m, "outside its range");
    } else if (vr == K) {
        if (m->d.mode > INITIAL && !is("fixed")) return refuse(m, "a fixed parameter");
    } else if (vr == V && m->d.mode != STEP && m->d.mode != END) {
    } else if (!(vr == W && is("computed"))) return refuse(m, "cannot be set");
    m->d.v[vr] = x;
    if (is("sharedparameter") && vr == K) kept = x - 2.0;
    if (is("computed") && vr == W) kept = x;
    return OK;
}
static int get_one(M *m, Vr vr, double *x)
{
    if (vr >= N) return is("unknown") ? OK : refuse(m, "no such variable");
    if (is("ended") && m->d.mode == END) return refuse(m, "not now");
    if (is("locked") && vr == DV) return refuse(m, "not to be read");
    *x = vr == W ? output(m) : vr == DV ? slope(m) : vr == Z ? 5 - m->d.v[V] : m->d.v[vr];
    if (is("computed") && vr == W && kept != 0) *x = kept;
    return OK;
}
#if FMI == 2
F(SetReal)(M *m, const Vr *vr, size_t n, const double *x COUNT)
#else
F(SetFloat64)(M *m, const Vr *vr, size_t n, const double *x COUNT)
#endif
{
    int status = OK;
    if (is("nullarray") && !vr) abort();
    if (is("setone") && n > 1) n = 1;
    if (is("forgets") && m->d.mode == NEW) return OK;
    for (size_t k = 0; k < n; k++) status |= set_one(m, vr[k], x[k]);
    return status;
}
#if FMI == 2
F(GetReal)(M *m, const Vr *vr, size_t n, double *x COUNT)
#else
F(GetFloat64)(M *m, const Vr *vr, size_t n, double *x COUNT)
#endif
{
    int status = OK;
#if FMI == 3
    if (count < n && !is("sizes")) return refuse(m, "no room");
#endif
    if (is("getone") && n > 1) n = 1;
    for (size_t k = 0; k < n; k++) status |= get_one(m, vr[k], x + k);
    return status;
}
#if FMI == 2
F(SetInteger)(M *m, const Vr *vr, size_t n, const Integer *x COUNT)
#else
F(SetInt64)(M *m, const Vr *vr, size_t n, const Integer *x COUNT)
#endif
{
    if (n != 1 || *vr != I || m->d.mode > INITIAL) return refuse(m, "cannot be set");
    m->d.i = *x;
    return OK;
}
#if FMI == 2
F(GetInteger)(M *m, const Vr *vr, size_t n, Integer *x COUNT)
#else
F(GetInt64)(M *m, const Vr *vr, size_t n, Integer *x COUNT)
#endif
{
    if (n != 1 || *vr != I) return refuse(m, "no such variable");
    *x = m->d.i;
    return OK;
}
F(SetBoolean)(M *m, const Vr *vr, size_t n, const Bool *x COUNT)
{
    if (n != 1 || *vr != B || m->d.mode > INITIAL) return refuse(m, "cannot be set");
    m->d.b = *x;
    return OK;
}
F(GetBoolean)(M *m, const Vr *vr, size_t n, Bool *x COUNT)
{
    if (n != 1 || (*vr != B && !is("othertype"))) return refuse(m, "no such variable");
    *x = m->d.b;
    return OK;
}
F(GetString)(M *m, const Vr *vr, size_t n, const char **x COUNT)
{
    if (n != 1 || *vr != S) return refuse(m, "no such variable");
    *x = is("nullstring") ? NULL : is("startstring") ? "other" : "text";
    return OK;
}
F(SetString)(M *m, const Vr *vr, size_t n, const char *const *x COUNT)
{
    (void)x;
    return n == 1 && *vr == S && m->d.mode <= INITIAL ? OK : refuse(m, "cannot be set");
}
#if FMI == 2
F(GetDirectionalDerivative)(M *m, const Vr *z, size_t nz, const Vr *x, size_t nx, const double *dx, double *dz)
#else
F(GetDirectionalDerivative)(M *m, const Vr *z, size_t nz, const Vr *x, size_t nx, const double *dx, size_t ndx, double *dz, size_t ndz)
#endif
{
#if FMI == 3
    (void)ndx, (void)ndz;
#endif
    if (is("noslope")) return refuse(m, "no derivative");
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0;
        for (size_t j = 0; j < nx; j++) {
            double a = 0;
            if (z[i] == W) a = x[j] == U ? (is("slope") ? 2 : 1) : x[j] == V ? m->d.v[K] : 0;
            if (z[i] == DV) a = x[j] == U ? m->d.v[K] : x[j] == V ? (is("exchangeslope") ? 1 : -1) : 0;
            if (z[i] == V) a = x[j] == V;
            dz[i] = is("lastknown") ? a * dx[j] : dz[i] + a * dx[j];
        }
    }
    return OK;
}

#if FMI == 3
F(GetAdjointDerivative)(M *m, const Vr *z, size_t nz, const Vr *x, size_t nx, const double *dz, size_t ndz, double *dx, size_t ndx)
{
    (void)ndz;
    for (size_t j = 0; j < nx; j++) {
        double one = 1, column;
        dx[j] = 0;
        for (size_t i = 0; i < nz; i++) {
            fmi3GetDirectionalDerivative(m, z + i, 1, x + j, 1, &one, 1, &column, ndx);
            dx[j] += (is("adjoint") ? 2 : 1) * column * dz[i];
        }
    }
    return OK;
}
#endif

/* -- steps ------------------------------------------------------------------------------------------------------------ */

static int step(M *m, double t, double h)
{
    if (m->d.mode == END ? !is("late") : m->d.mode != STEP && !is("early")) return refuse(m, "not now");
    if (is("jump")) m->d.v[TIME] = t;
    if (is("noise") ? t != m->d.v[TIME] : fabs(t - m->d.v[TIME]) > 1e-9 * (1 + fabs(t))) return refuse(m, "another time");
    if (is("oddhang") && isinf(h)) for (;;) pause();
    if (is("hugehang") && h > 100) for (;;) pause();
    if (!(h > 0 && isfinite(h)) && !is(h < 0 ? "back" : h == 0 ? "zero" : "odd")) {
        if (!(is("zeronan") && h == 0)) return refuse(m, "no step size");
    }
    if (is("failing") && t > 0.5) return refuse(m, "fails");
    if (is("crash")) abort();
    if (is("hang")) for (;;) pause();
    if (is("loud")) fputs("step\n", stderr);
    if (is("loudout")) printf("step\n");
    say(m, OK, "logAll", "step");
    if (is("logsame") && m->log) m->d.v[V] += 1e-12;
    if (!m->d.steps++) m->d.h = h;
    double length = is("ownstep") ? 1e-3 : is("firststep") ? m->d.h : h;
    double a = 1.0 + m->d.v[K] * m->d.v[U];
    if (is("sharedparameter")) a += kept;
    if (is("threads")) {
        kept = a;
        usleep(50);
        a = kept;
    }
    if (is("hugenan")) m->d.v[V] = a + (m->d.v[V] - a) * exp(length) / exp(2 * length);
    else m->d.v[V] = a + (m->d.v[V] - a) * exp(-length);
    if (is("percall")) m->d.v[V] += 1e-3;
    if (is("zero") && h == 0) m->d.v[V] += 1e-3;
    if (is("zeronan")) m->d.v[V] *= h / h;
    if (is("shared")) shared += 1e-6;
    m->d.v[TIME] = t + h;
    return OK;
}
#if FMI == 2
F(DoStep)(M *m, double t, double h, int p)
{
    (void)p;
    return step(m, t, h);
}
F(GetBooleanStatus)(M *m, int kind, int *x)
{
    (void)m, (void)kind;
    *x = 0;
    return OK;
}
#else
F(DoStep)(M *m, double t, double h, bool p, bool *event, bool *terminate, bool *early, double *last)
{
    (void)p;
    int status = step(m, t, h);
    *event = m->d.sets < 0, *terminate = false, *early = is("early return");
    *last = t + (is("last") ? h / 2 : h);
    return status;
}
F(EnterStepMode)(M *m)
{
    m->d.mode = STEP;
    return OK;
}
#endif

/* -- states ----------------------------------------------------------------------------------------------------------- */

#if FMI == 2
#define STATE(verb) JOIN(verb, FMUstate)
#define SIZE SerializedFMUstateSize
#define WRITE SerializeFMUstate
#define READ DeSerializeFMUstate
#else
#define STATE(verb) JOIN(verb, FMUState)
#define SIZE SerializedFMUStateSize
#define WRITE SerializeFMUState
#define READ DeserializeFMUState
#endif
F(STATE(Get))(M *m, State **s)
{
    if (is("refill") && *s) return OK;
    if (!*s) *s = calloc(1, sizeof **s);
    (*s)->d = m->d, (*s)->dead = 0;
    if (is("stateafter")) kept = 0;
    return OK;
}
F(STATE(Set))(M *m, State *s)
{
    if (is("state") || (is("stateonce") && s->dead) || (is("stateafter") && kept < 0)) return OK;
    if (is("stateinput")) s->d.v[U] = m->d.v[U];
    if (is("stateparameter")) s->d.v[K] = m->d.v[K];
    m->d = s->d;
    s->dead = 1;
    return OK;
}
F(STATE(Free))(M *m, State **s)
{
    (void)m;
    if (!*s && is("nullstate")) abort();
    if (!is("leakstate")) free(*s);
    *s = NULL;
    return OK;
}
F(SIZE)(M *m, State *s, size_t *n)
{
    (void)m, (void)s;
    *n = sizeof(Data);
    return OK;
}
F(WRITE)(M *m, State *s, char *bytes, size_t n)
{
    Data d = s->d;
    (void)m;
    if (is("bytes")) d.v[V] = 0;
    if (is("pointer")) {
        Data *copy = malloc(sizeof *copy);
        *copy = d;
        memcpy(&d.v[V], &copy, sizeof copy);
    }
    if (is("table")) table[rows] = d, d.v[V] = rows++;
    memcpy(bytes, &d, n);
    return OK;
}
F(READ)(M *m, const char *bytes, size_t n, State **s)
{
    (void)m;
    if (!*s) *s = calloc(1, sizeof **s);
    memcpy(&(*s)->d, bytes, n);
    if (is("pointer")) {
        Data *copy;
        memcpy(&copy, &(*s)->d.v[V], sizeof copy);
        (*s)->d = *copy;
    }
    if (is("table")) (*s)->d = table[(int)(*s)->d.v[V]], (*s)->d.mode = STEP;
    return OK;
}

/* -- Model Exchange --------------------------------------------------------------------------------------------------- */

F(EnterEventMode)(M *m)
{
    m->d.mode = EVENT;
    return OK;
}
F(EnterContinuousTimeMode)(M *m)
{
    m->d.mode = CONTINUOUS;
    return OK;
}
F(SetTime)(M *m, double t)
{
    m->d.v[TIME] = t;
    return OK;
}
F(GetContinuousStates)(M *m, double *x, size_t n)
{
    if (n != 1) return refuse(m, "one state");
    *x = m->d.v[V];
    return OK;
}
F(SetContinuousStates)(M *m, const double *x, size_t n)
{
    if (n != 1) return refuse(m, "one state");
    m->d.v[V] = is("float") ? (float)*x : *x;
    return OK;
}
F(GetNominalsOfContinuousStates)(M *m, double *x, size_t n)
{
    (void)m, (void)n;
    *x = is("nominals") ? 0 : 1;
    return OK;
}
F(GetEventIndicators)(M *m, double *z, size_t n)
{
    if (n != 1) return refuse(m, "one indicator");
    *z = is("indicators") ? INFINITY : 5 - m->d.v[V];
    return OK;
}
#if FMI == 2
typedef struct { int again, terminate, nominals, values, defined; double next; } Events;
F(GetDerivatives)(M *m, double *dx, size_t n)
{
    (void)n;
    *dx = is("order") ? 2 * slope(m) : slope(m);
    return OK;
}
F(NewDiscreteStates)(M *m, Events *events)
{
    (void)m;
    memset(events, 0, sizeof *events);
    events->again = is("endless");
    return OK;
}
F(CompletedIntegratorStep)(M *m, int prior, int *event, int *terminate)
{
    (void)m, (void)prior;
    *event = *terminate = 0;
    return is("completed") ? ERROR : OK;
}
#else
F(GetContinuousStateDerivatives)(M *m, double *dx, size_t n)
{
    if (n != 1) return refuse(m, "one state");
    *dx = is("order") ? 2 * slope(m) : slope(m);
    return OK;
}
F(UpdateDiscreteStates)(M *m, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
{
    (void)m, (void)next;
    *terminate = *nominals = *values = *defined = false;
    *again = is("endless");
    return OK;
}
F(CompletedIntegratorStep)(M *m, bool prior, bool *event, bool *terminate)
{
    (void)m, (void)prior;
    *event = *terminate = false;
    return is("completed") ? ERROR : OK;
}
F(GetNumberOfContinuousStates)(M *m, size_t *n)
{
    (void)m;
    *n = is("nostates") ? 0 : 1;
    return OK;
}
F(GetNumberOfEventIndicators)(M *m, size_t *n)
{
    (void)m;
    *n = is("noindicators") ? 0 : 1;
    return OK;
}
#endif
