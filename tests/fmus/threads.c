/* A host that makes, steps and frees instances in several threads at once: threads LIBRARY TOKEN. Exits with 0 if every
 * call went well and every instance gave the same numbers. */
#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>

#include "fmi2Functions.h"

enum { THREADS = 4, LIVES = 20000, STEPS = 3 };

static fmi2InstantiateTYPE *make;
static fmi2FreeInstanceTYPE *drop;
static fmi2SetupExperimentTYPE *setup;
static fmi2EnterInitializationModeTYPE *enter;
static fmi2ExitInitializationModeTYPE *leave;
static fmi2DoStepTYPE *step;
static fmi2GetRealTYPE *get;
static const char *token;
static fmi2ValueReference output;

static void ignore(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e; (void)n; (void)s; (void)c; (void)m;
}

static int life(double *value)
{
    const fmi2CallbackFunctions functions = {ignore, calloc, free, 0, 0};
    fmi2Component c = make("one", fmi2CoSimulation, token, "", &functions, 0, 0);
    if (!c || setup(c, 0, 0.0, 0.0, 0, 0.0) || enter(c) || leave(c)) return 1;
    for (int k = 0; k < STEPS; k++)
        if (step(c, 1e-3 * k, 1e-3, 1)) return 1;
    if (get(c, &output, 1, value)) return 1;
    drop(c);
    return step(c, 0.0, 1e-3, 1) != fmi2Error;
}

static void *lives(void *expected)
{
    for (int k = 0; k < LIVES; k++) {
        double value;
        if (life(&value) || value != *(double *)expected) return expected;
    }
    return 0;
}

int main(int count, char **arguments)
{
    void *library = count == 4 ? dlopen(arguments[1], RTLD_NOW) : 0;
    if (!library) return 2;
    token = arguments[2];
    output = (fmi2ValueReference)atoi(arguments[3]);
    *(void **)&make = dlsym(library, "fmi2Instantiate");
    *(void **)&drop = dlsym(library, "fmi2FreeInstance");
    *(void **)&setup = dlsym(library, "fmi2SetupExperiment");
    *(void **)&enter = dlsym(library, "fmi2EnterInitializationMode");
    *(void **)&leave = dlsym(library, "fmi2ExitInitializationMode");
    *(void **)&step = dlsym(library, "fmi2DoStep");
    *(void **)&get = dlsym(library, "fmi2GetReal");
    double expected;
    if (life(&expected)) return 3;
    pthread_t threads[THREADS];
    int failed = 0;
    for (int k = 0; k < THREADS; k++) pthread_create(&threads[k], 0, lives, &expected);
    for (int k = 0; k < THREADS; k++) {
        void *result;
        pthread_join(threads[k], &result);
        failed |= result != 0;
    }
    return failed;
}
