/* A servo with bristle friction under a PI controller, for the study of conditions; written apart from the package's plant.
 *
 * Normalised by the inertia:  v' = b u + d - w - tau w' - alpha2 v,   w' = K(v) v - c(v) |v| w
 *     modified law:  K = s0 + s1 exp(-(v/w1)^2) + s2 exp(-((|v| - m2)/w2)^2),  c constant
 *     LuGre (law 1): K = s0,  1/c = a0 + a1 exp(-(v/v0)^2)
 * by the classical Runge-Kutta method at small fixed steps, where the package uses an implicit step with error control. */
#include <math.h>

#define EXPORT __attribute__((visibility("default")))

typedef struct {
    double law; /* 0 modified, 1 LuGre */
    double alpha2, b, tau;
    double s0, s1, s2, c;
    double w1, m2, w2; /* rad/s */
    double a0, a1, v0; /* rad, rad, rad/s */
    double kp, ki, limit; /* controller: V s/rad, V/rad, V */
} Servo;

static void rates(const Servo *p, double scale, double push, const double *x, double *dx) {
    double v = x[1], w = x[2], speed = fabs(v), gain, c, dw;
    if (p->law > 0.5) {
        gain = p->s0;
        c = 1.0 / (p->a0 + p->a1 * exp(-(v / p->v0) * (v / p->v0)));
    } else {
        double one = v / p->w1, two = (speed - p->m2) / p->w2;
        gain = p->s0 + p->s1 * exp(-one * one) + p->s2 * exp(-two * two);
        c = p->c;
    }
    gain *= scale;
    dw = gain * v - c * speed * w;
    dx[0] = v;
    dx[1] = push - w - p->tau * dw - p->alpha2 * v;
    dx[2] = dw;
}

/* Arrays of n values, one a sample: reference [rad/s], torque d [rad/s2], error of the input [V], scale of friction [1];
 * out: u [V] as commanded, position [rad], velocity [rad/s] at the sampling instants. */
EXPORT void servo_run(const Servo *p, long n, long parts, double period, const double *reference, const double *torque,
                      const double *noise, const double *scale, double *u_out, double *theta_out, double *v_out) {
    double x[3] = {0.0, 0.0, 0.0}, integral = 0.0, u = 0.0, h = period / (double)parts;
    for (long k = 0; k < n; k++) {
        double error = reference[k] - x[1], next = p->kp * error + p->ki * integral, held;
        u_out[k] = u;
        theta_out[k] = x[0];
        v_out[k] = x[1];
        if (fabs(next) <= p->limit || next * error < 0) integral += period * error;
        held = p->b * (u + noise[k]) + torque[k];
        for (long i = 0; i < parts; i++) {
            double k1[3], k2[3], k3[3], k4[3], y[3];
            rates(p, scale[k], held, x, k1);
            for (int j = 0; j < 3; j++) y[j] = x[j] + 0.5 * h * k1[j];
            rates(p, scale[k], held, y, k2);
            for (int j = 0; j < 3; j++) y[j] = x[j] + 0.5 * h * k2[j];
            rates(p, scale[k], held, y, k3);
            for (int j = 0; j < 3; j++) y[j] = x[j] + h * k3[j];
            rates(p, scale[k], held, y, k4);
            for (int j = 0; j < 3; j++) x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
        }
        u = fmax(-p->limit, fmin(p->limit, next)); /* acts one sample after the velocity it answers to */
    }
}
