/* A good FMI 2 FMU of v' = u - v, gain k: y = k v. What is wrong with it is in the environment; the functions that are missing here
 * are added as stubs. */
#define _XOPEN_SOURCE 700
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#define E __attribute__((visibility("default")))

enum { U = 1, K = 2, Y = 3, N = 4 };
typedef struct { double v[N]; } M;

static double shared[N];
static int lives;
static char *volatile lost;

static int is(const char *what)
{
    const char *given = getenv("MUTANT");
    return given && !strcmp(given, what);
}

static void start(M *m)
{
    if (!is("reset") || !lives) memset(m->v, 0, sizeof m->v);
    m->v[K] = is("start") ? 3.0 : 2.0;
    if (is("again")) m->v[Y] = lives;
    lives++;
}

E const char *fmi2GetTypesPlatform(void) { return "default"; }
E const char *fmi2GetVersion(void) { return "2.0"; }
E void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *c, int vis, int log)
{
    (void)n, (void)t, (void)r, (void)c, (void)vis, (void)log;
    if (strcmp(g, "{good}") && !is("token")) return NULL;
    M *m = calloc(1, sizeof *m);
    if (is("reset")) lives = 0;
    start(m);
    return m;
}
E void fmi2FreeInstance(void *m) { free(m); }
E int fmi2Reset(M *m)
{
    if (is("leak")) lost = calloc(1, 1 << 20), memset(lost, 1, 1 << 20);
    start(m);
    return 0;
}
E int fmi2SetReal(M *m, const unsigned *vr, size_t n, const double *x)
{
    for (size_t i = 0; i < n; i++) {
        if (!isfinite(x[i]) && !is("naninput")) return 3;
        m->v[vr[i]] = x[i];
    }
    return 0;
}
E int fmi2GetReal(M *m, const unsigned *vr, size_t n, double *x)
{
    for (size_t i = 0; i < n; i++) x[i] = is("shared") && vr[i] == Y ? shared[Y] : m->v[vr[i]];
    return 0;
}
E int fmi2DoStep(M *m, double t, double h, int p)
{
    (void)t, (void)p;
    if (h <= 0 && !is("back")) return 3;
    if (is("loud")) fputs("step\n", stderr);
    if (is("crash")) abort();
    if (is("hang")) for (;;) pause();
    m->v[Y] += h * (1.0 + m->v[K] * m->v[U] - m->v[Y]);
    if (is("nan") && m->v[Y] > 5e-3) m->v[Y] = NAN;
    shared[Y] = is("shared") ? shared[Y] + m->v[Y] : 0;
    return 0;
}
E int fmi2GetFMUstate(M *m, M **s)
{
    if (!*s) *s = malloc(sizeof **s);
    **s = *m;
    return 0;
}
E int fmi2SetFMUstate(M *m, const M *s)
{
    if (!is("state")) *m = *s;
    return 0;
}
E int fmi2FreeFMUstate(M *m, M **s)
{
    (void)m;
    free(*s);
    *s = NULL;
    return 0;
}
