/* Kalman filter of a servo that slides: position, velocity, disturbance torque; with the slopes of all by some
 * parameters. A model is 22 numbers: transition[9], covariance of a step[9], input[3], variance of the sensor[1];
 * the slopes of a model by `slopes` parameters follow it. `shown` is the state that the sensor shows, 0 or 1.
 * Source: durbin2012 (chapter 4, filter; section 7.2, likelihood of the innovations). */
#include <math.h>
#include <string.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define N 3
#define MODEL 22
#define MOST_SLOPES 8
#define MOST_COLUMNS 256
#define STEADY 1e-10 /* relative change of the variances in a sample below which gains no longer change */

static void multiply(const double *a, const double *b, double *c) {
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) {
      c[i * N + j] = 0;
      for (int k = 0; k < N; k++) c[i * N + j] += a[i * N + k] * b[k * N + j];
    }
}

static void multiply_transposed(const double *a, const double *b, double *c) {
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) {
      c[i * N + j] = 0;
      for (int k = 0; k < N; k++) c[i * N + j] += a[i * N + k] * b[j * N + k];
    }
}

/* Gains [samples][3] and variances of the innovations [samples] from the covariance of the prediction [9] on, and
 * their slopes [samples][slopes][3], [samples][slopes]; returns the samples until they are steady. */
EXPORT long long kalman_gains(const double *model, int slopes, int shown, double *covariance, long long samples,
                              double *gain, double *variance, double *gain_slope, double *variance_slope) {
  const double *a = model, *q = model + 9, r = model[21];
  double *p = covariance;
  for (long long t = 0; t < samples; t++) {
    double s = p[shown * N + shown] + r, inverse = 1 / s, c[N], filtered[9], m[9], next[9], change = 0;
    for (int i = 0; i < N; i++) c[i] = p[i * N + shown];
    variance[t] = s;
    for (int i = 0; i < N; i++) {
      double x = 0;
      for (int j = 0; j < N; j++) x += a[i * N + j] * c[j];
      gain[t * N + i] = x * inverse;
    }
    for (int i = 0; i < N; i++)
      for (int j = 0; j < N; j++) filtered[i * N + j] = p[i * N + j] - c[i] * c[j] * inverse;
    multiply(a, filtered, m);
    multiply_transposed(m, a, next);
    for (int n = 0; n < slopes; n++) {
      const double *by = model + (n + 1) * MODEL;
      double *d = covariance + (n + 1) * 9, dc[N], df[9], one[9], two[9];
      double ds = d[shown * N + shown] + by[21];
      for (int i = 0; i < N; i++) dc[i] = d[i * N + shown];
      variance_slope[t * slopes + n] = ds;
      for (int i = 0; i < N; i++) {
        double x = 0;
        for (int j = 0; j < N; j++) x += by[i * N + j] * c[j] + a[i * N + j] * dc[j];
        gain_slope[(t * slopes + n) * N + i] = (x - gain[t * N + i] * ds) * inverse;
      }
      for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
          df[i * N + j] = d[i * N + j] - (dc[i] * c[j] + c[i] * dc[j]) * inverse + c[i] * c[j] * inverse * inverse * ds;
      multiply(by, filtered, m);
      multiply_transposed(m, a, one);
      multiply(a, df, m);
      multiply_transposed(m, a, two);
      for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
          d[i * N + j] = one[i * N + j] + one[j * N + i] + two[i * N + j] + by[9 + i * N + j];
    }
    for (int i = 0; i < N; i++) {
      double now = next[i * N + i] + q[i * N + i];
      change = fmax(change, fabs(now - p[i * N + i]) / (fabs(now) + 1e-300));
    }
    for (int i = 0; i < N; i++)
      for (int j = 0; j < N; j++) p[i * N + j] = 0.5 * (next[i * N + j] + next[j * N + i]) + q[i * N + j];
    if (change < STEADY) return t + 1;
  }
  return samples;
}

/* What the filter runs over: `count` stretches of samples [begin, end) of arrays of `length` samples. */
typedef struct {
  long long count, length;
  const long long *begin, *end;
  double h;
} Stretches;

/* The gains that `kalman_gains` gave. */
typedef struct {
  long long samples;
  const double *gain, *gain_slope, *variance;
} Gains;

/* The start: position and speed from the first two samples, or the first speed; no disturbance. */
static void begin_at(const double *shows, int shown, double h, double *x) {
  x[0] = shown == 0 ? shows[1] : 0;
  x[1] = shown == 0 ? (shows[1] - shows[0]) / h : shows[0];
  x[2] = 0;
}

static void advance(const double *model, double torque, const double *gain, double innovation, double *x) {
  double next[N];
  for (int i = 0; i < N; i++) {
    next[i] = model[18 + i] * torque + (gain ? gain[i] * innovation : 0);
    for (int j = 0; j < N; j++) next[i] += model[i * N + j] * x[j];
  }
  memcpy(x, next, sizeof next);
}

/* Innovations [length] of measured samples under a torque [length], and their slopes [length][slopes]. */
EXPORT void kalman_innovations(const double *model, int slopes, int shown, const Stretches *over, const Gains *gains,
                               const double *measured, const double *torque, double *innovation, double *slope) {
  double x[N], dx[MOST_SLOPES * N];
  for (long long c = 0; c < over->count; c++) {
    long long first = over->begin[c] + (shown == 0);
    begin_at(measured + over->begin[c], shown, over->h, x);
    memset(dx, 0, sizeof dx);
    for (long long k = first; k < over->end[c]; k++) {
      long long t = k - first - 1;
      if (t >= gains->samples) t = gains->samples - 1;
      const double *gain = k == first ? 0 : gains->gain + t * N;
      double e = gain ? measured[k] - x[shown] : 0;
      innovation[k] = e;
      for (int n = 0; n < slopes; n++) {
        const double *by = model + (n + 1) * MODEL;
        double *d = dx + n * N, de = gain ? -d[shown] : 0, next[N];
        slope[k * slopes + n] = de;
        for (int i = 0; i < N; i++) {
          next[i] = by[18 + i] * torque[k];
          for (int j = 0; j < N; j++) next[i] += model[i * N + j] * d[j] + by[i * N + j] * x[j];
          if (gain) next[i] += gain[i] * de + gains->gain_slope[(t * slopes + n) * N + i] * e;
        }
        memcpy(d, next, sizeof next);
      }
      advance(model, torque[k], gain, e, x);
    }
  }
}

/* The end of each stretch: the first sample for which the filter predicts no speed in its direction, or that is `most`
 * standard deviations from the prediction; and the speeds [length] that it predicts up to there. */
EXPORT void kalman_ends(const double *model, int shown, const Stretches *over, const Gains *gains,
                        const double *measured, const double *torque, const double *direction, double most, long long *end,
                        double *speed) {
  for (long long c = 0; c < over->count; c++) {
    long long first = over->begin[c] + (shown == 0), k = first;
    double x[N];
    begin_at(measured + over->begin[c], shown, over->h, x);
    for (; k < over->end[c] && direction[c] * x[1] > 0; k++) {
      long long t = k - first - 1;
      if (t >= gains->samples) t = gains->samples - 1;
      const double *gain = k == first ? 0 : gains->gain + t * N;
      double e = gain ? measured[k] - x[shown] : 0;
      if (gain && e * e > most * most * gains->variance[t]) break;
      speed[k] = x[1];
      advance(model, torque[k], gain, e, x);
    }
    end[c] = k;
  }
}

/* What the same filter makes [length][columns] of other torques [columns][length]; `shows` are what the sensor shows
 * of each in addition [columns][length], or NULL. */
EXPORT void kalman_columns(const double *model, int shown, const Stretches *over, const Gains *gains,
                           long long columns, const double *torques, const double *shows, double *filtered) {
  static const double nothing[2] = {0, 0};
  for (long long c = 0; c < over->count; c++)
    for (long long m = 0; m < columns; m++) {
      const double *torque = torques + m * over->length, *y = shows ? shows + m * over->length : 0;
      long long first = over->begin[c] + (shown == 0);
      double x[N];
      begin_at(y ? y + over->begin[c] : nothing, shown, over->h, x);
      for (long long k = first; k < over->end[c]; k++) {
        long long t = k - first - 1;
        if (t >= gains->samples) t = gains->samples - 1;
        const double *gain = k == first ? 0 : gains->gain + t * N;
        double e = gain ? (y ? y[k] : 0) - x[shown] : 0;
        filtered[k * columns + m] = e;
        advance(model, torque[k], gain, e, x);
      }
    }
}
