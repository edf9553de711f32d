/* The reference of benchmarks/speed.py: the same generated C as inside the FMUs, in one loop without any FMI. */
#include <stddef.h>

int plant_core_advance(void *core, double h);
int observer_core_advance(void *core, double h);
int controller_core_advance(void *core, double h);

typedef int (*Advance)(void *core, double h);

/* A core begins with its variable table v[]. from, to: places of what is copied between the cores' tables; record: taps. */
__attribute__((visibility("default")))
long long plain_run(void *plant, void *controller, void *observer, long long n, double h, int n_links, double *const *from,
                    double *const *to, int n_taps, const double *const *taps, double *record)
{
    void *const cores[3] = {plant, controller, observer};
    const Advance advance[3] = {plant_core_advance, controller_core_advance, observer_core_advance};
    double bus[16];
    for (int i = 0; i < n_taps; i++) record[i] = *taps[i];
    for (long long k = 0; k < n; k++) {
        for (int i = 0; i < n_links; i++) bus[i] = *from[i];
        for (int i = 0; i < n_links; i++) *to[i] = bus[i];
        for (int i = 0; i < 3; i++) {
            *(double *)cores[i] = (double)k * h;
            if (advance[i](cores[i], h)) return k;
        }
        for (int i = 0; i < n_taps; i++) record[(k + 1) * n_taps + i] = *taps[i];
    }
    return n;
}
