/* A host for any platform: drive LIBRARY TOKEN STEPS INPUT OUTPUT... makes an FMI 2 instance, moves one input and prints the bits
 * of the outputs after every step. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#ifdef _WIN32
#include <windows.h>
#define LOAD(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define LOAD(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif

enum { MOST = 8 };

static void ignore(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e; (void)n; (void)s; (void)c; (void)m;
}

int main(int count, char **given)
{
    void *library = count > 5 ? LOAD(given[1]) : 0;
    if (!library || count - 5 > MOST) return 2;
    fmi2InstantiateTYPE *make = (fmi2InstantiateTYPE *)FIND(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = (fmi2SetupExperimentTYPE *)FIND(library, "fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter = (fmi2EnterInitializationModeTYPE *)FIND(library, "fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave = (fmi2ExitInitializationModeTYPE *)FIND(library, "fmi2ExitInitializationMode");
    fmi2SetRealTYPE *set = (fmi2SetRealTYPE *)FIND(library, "fmi2SetReal");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)FIND(library, "fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)FIND(library, "fmi2DoStep");
    fmi2FreeInstanceTYPE *drop = (fmi2FreeInstanceTYPE *)FIND(library, "fmi2FreeInstance");
    const fmi2CallbackFunctions functions = {ignore, calloc, free, 0, 0};
    fmi2Component c = make("one", fmi2CoSimulation, given[2], "", &functions, 0, 0);
    if (!c || setup(c, 0, 0.0, 0.0, 0, 0.0) || enter(c) || leave(c)) return 3;
    const fmi2ValueReference input = (fmi2ValueReference)atoi(given[4]);
    fmi2ValueReference outputs[MOST];
    const int n = count - 5, steps = atoi(given[3]);
    for (int i = 0; i < n; i++) outputs[i] = (fmi2ValueReference)atoi(given[5 + i]);
    for (int k = 0; k < steps; k++) {
        const double u = (double)(k / 50 * 37 % 101) / 25.0 - 2.0; /* plateaus of 50 steps, both signs */
        double values[MOST];
        if (set(c, &input, 1, &u) || step(c, 1e-3 * k, 1e-3, 1) || get(c, outputs, (size_t)n, values)) return 4;
        for (int i = 0; i < n; i++) {
            uint64_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            printf("%016" PRIx64 "%c", bits, i + 1 < n ? ' ' : '\n');
        }
    }
    drop(c);
    return 0;
}
