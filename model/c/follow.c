/* Lanes that follow one reference in a position loop, each under its own disturbance. */
#include "lanes.h"

#include <math.h>

/* Drive all lanes over n steps of length h by u = kp (r - theta) + kd (r' - v) within [low, high]; the servo is driven by u and the
 * disturbance together, from a time on. The lanes have been initialised. reference: r and r' (n, 2); places of input, position,
 * speed and output; disturbance, seen, driven: (n, LANES); good: of lanes that came to the end. */
EXPORT void lanes_follow(Lanes *l, long long n, double h, double time, const int *places, const double *gains,
                         const double *ends, const double *reference, const double *disturbance,
                         double *seen, double *driven, unsigned char *good)
{
    const int input = places[0], position = places[1], speed = places[2], observed = places[3];
    l->s = 0;
    l->shift = ALL(time);
    l->v[0] = l->shift;
    for (long long i = 0; i < n && ANY(l->on); i++) {
        for (int k = 0; k < LANES; k++) {
            const double error = reference[2 * i] - l->v[position][k], slip = reference[2 * i + 1] - l->v[speed][k];
            const double u = fmin(fmax(gains[0] * error + gains[1] * slip, ends[0]), ends[1]);
            driven[i * LANES + k] = u;
            seen[i * LANES + k] = l->v[observed][k];
            l->v[input][k] = u + disturbance[i * LANES + k];
        }
        lanes_advance(l, h * (double)i, h);
    }
    for (int k = 0; k < LANES; k++) good[k] = l->on[k] != 0;
}
