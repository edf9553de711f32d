/* The hidden truth of the blind test: a servo with bristle friction, every effect in two functional forms, closed loop.
 *
 * Written apart from the package's own plant: explicit symmetric splitting with exact relaxation of the bristles, at small
 * fixed steps, where the package solves a set-valued law. What is zero is off. truth.py reads the two structs below, so a
 * field is named here only; a catalogue parameter "gravity.phase" is the field gravity_phase. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define PERIOD 1e-3 /* s, sampling of controller and records */
#define EXPORT __attribute__((visibility("default")))

typedef struct {
    double J;           /* kg.m2, all of it */
    double a2;          /* N.m.s/rad */
    double Fc;          /* N.m */
    double sigma0;      /* N.m/rad, bristles of the base friction */
    double sigma1;      /* N.m.s/rad, their damping */
    double sigma1_speed; /* rad/s, above which the damping fades; 0: constant */
    double regular;     /* rad/s, F = Fc v/(|v| + regular) in place of bristles */
    double step;        /* s, internal step; divides the period */

    double encoder_play_play;
    double encoder_play_rounding; /* other: exponent n, e' = -v (1 - |2 e/play|^n) */

    double asymmetric_viscous_coefficient;
    double asymmetric_viscous_power; /* other: of |v|, in place of 1; scaled at 5 rad/s */

    double gear_loss_driving;
    double gear_loss_driven;
    double gear_loss_power; /* other: exponent of the torque, scaled at 0.4 N.m */

    double bias_torque;
    double bias_ripple; /* other: share that varies with position */
    double bias_ripple_phase;

    double asymmetric_coulomb_share;
    double asymmetric_coulomb_viscous; /* other: asymmetry of the viscous part */

    double quadratic_drag_coefficient;
    double quadratic_drag_exponent; /* other: of |v|, in place of 2; torque c |v|^p at 1 rad/s */

    double stribeck_excess;
    double stribeck_speed;
    double stribeck_kind; /* 0 Gaussian, 1 exponential, 2 Lorentzian */

    double presliding_stiffness;
    double presliding_split; /* other: share of Fc that a second, softer element carries */
    double presliding_ratio; /* other: stiffness of the second element over that of the first */

    double bristle_damping_stiffness;
    double bristle_damping_damping;
    double bristle_damping_fade; /* other: rad/s, above which the damping fades */

    double cogging_amplitude;
    double cogging_phase;
    double cogging_periods;
    double cogging_amplitude2;
    double cogging_phase2;
    double cogging_third; /* other: share of a third harmonic */
    double cogging_third_phase;
    double cogging_steep; /* other: tanh(steep sin)/tanh(steep) */

    double gravity_amplitude;
    double gravity_phase;
    double gravity_second; /* other: share of a second harmonic */
    double gravity_second_phase;

    double dead_zone_width;
    double dead_zone_kind; /* 0 sharp, 1 hyperbola, 2 tanh */

    double saturation_limit;
    double saturation_sharpness; /* other: u/(1 + |u/s|^n)^(1/n) */

    double gain_asymmetry_share;
    double gain_asymmetry_width; /* other: rounded corner */
    double gain_asymmetry_power; /* other: |u|^p, the share holding at 0.4 N.m */

    double input_delay_delay;
    double input_delay_jitter; /* other: relative, changes every 10 ms */

    double electrical_pole_time_constant;
    double electrical_pole_order; /* other: 2 = two poles of half the time constant */

    double backlash_share;
    double backlash_play;
    double backlash_stiffness;
    double backlash_dissipation;
    double backlash_hertz; /* other: exponent of the deformation, scaled at 5 mrad */

    double compliance_share;
    double compliance_stiffness;
    double compliance_damping;
    double compliance_stiffening; /* other: 1/rad2 */

    double load_friction_coefficient;
    double load_friction_power; /* other: exponent, scaled at 0.4 N.m */
    double load_friction_kind; /* other: 1 for a part that falls with the speed, with the two below */
    double load_friction_falling;
    double load_friction_speed;

    double hard_stop_stiffness;
    double hard_stop_upper;
    double hard_stop_lower;
    double hard_stop_kind; /* 0 linear, 1 quadratic (scaled at 50 mrad), 2 damped */
    double hard_stop_damping;

    double friction_drift_rate;
    double friction_drift_settling; /* other: s, drift rate*settling*(1 - exp(-t/settling)) */

    double disturbance_step_torque;
    double disturbance_step_onset;
    double disturbance_step_rise;
    double disturbance_step_kind; /* 0 ramp, 1 smooth first-order rise */

    double eccentric_encoder_amplitude;
    double eccentric_encoder_phase;
    double eccentric_encoder_second; /* other: share of a second harmonic */
    double eccentric_encoder_second_phase;

    double position_friction_amplitude;
    double position_friction_periods;
    double position_friction_phase;
    double position_friction_second; /* other: share of a second harmonic */
    double position_friction_second_phase;

    double return_spring_stiffness;
    double return_spring_rest;
    double return_spring_stiffening; /* other: 1/rad2 */

    double torque_ripple_share;
    double torque_ripple_periods;
    double torque_ripple_phase;
    double torque_ripple_second; /* other: share of a second harmonic */
    double torque_ripple_second_phase;

    double tone_amplitude; /* outside the catalogue from here on */
    double tone_frequency;
    double tone_phase;
    double compression_level; /* u/(1 + |u|/level) */
    double hysteresis_torque;
    double hysteresis_travel;
    double viscous_drift_rate;
    double inertia_ripple_share;
    double inertia_ripple_periods;
    double inertia_ripple_phase;
    double burst_amplitude;
    double burst_spacing;
    double burst_width;
    double burst_start;
    double burst_frequency;
} Plant;

typedef struct {
    double kp;
    double ki;
    double kd;
    double filter;     /* s, each of two stages behind the difference of the encoder */
    double limit;      /* N.m */
    double forward_J;  /* feedforward of the reference */
    double forward_a2;
    double forward_Fc;
    double resolution; /* rad */
} Loop;

enum { THETA, V, Z, ZB, THETA_LOAD, V_LOAD, LAG, LAG2, HYSTERESIS, LEAD, STATES };

static double sign(double x) { return (x > 0) - (x < 0); }
static double square(double x) { return x * x; }

static double jitter(long index)
{
    uint32_t x = (uint32_t)index * 2654435761u + 12345u;
    x ^= x >> 16; x *= 0x7feb352du; x ^= x >> 15; x *= 0x846ca68bu; x ^= x >> 16;
    return x / 2147483648.0 - 1;
}

/* Mean of the held input over a step that begins `at` seconds after the first sample; zero before it. */
static double held(const double *u, double at, double step)
{
    const double from = at / PERIOD, to = from + step / PERIOD;
    const double edge = floor(from) + 1;
    const long i = (long)floor(from);
    const double first = i < 0 ? 0 : u[i], next = i + 1 < 0 ? 0 : u[i + 1];
    if (to <= edge) return first;
    return (first * (edge - from) + next * (to - edge)) / (to - from);
}

static double command(const Plant *p, double u)
{
    const double d = p->dead_zone_width, s = p->saturation_limit;
    if (d > 0) {
        if (p->dead_zone_kind == 0) u = fabs(u) <= d ? 0 : u - d * sign(u);
        else if (p->dead_zone_kind == 1) u = sign(u) * (sqrt(u * u + d * d) - d);
        else u = u - d * tanh(u / d);
    }
    if (s > 0) {
        if (p->saturation_sharpness == 0) u = fabs(u) > s ? s * sign(u) : u;
        else u = u / pow(1 + pow(fabs(u) / s, p->saturation_sharpness), 1 / p->saturation_sharpness);
    }
    return u;
}

static double drive(const Plant *p, double u)
{
    const double w = p->gain_asymmetry_width, share = p->gain_asymmetry_share;
    if (share != 0) {
        if (p->gain_asymmetry_power > 0) u += share * 0.4 * pow(fabs(u) / 0.4, p->gain_asymmetry_power);
        else u += share * (w > 0 ? sqrt(u * u + w * w) - w : fabs(u));
    }
    if (p->compression_level > 0) u = u / (1 + fabs(u) / p->compression_level);
    return u;
}

static double drifted(const Plant *p, double t)
{
    if (p->friction_drift_rate == 0) return 1;
    if (p->friction_drift_settling == 0) return fmax(1 + p->friction_drift_rate * t, 0);
    return fmax(1 + p->friction_drift_rate * p->friction_drift_settling * (1 - exp(-t / p->friction_drift_settling)), 0);
}

/* Torque that a gear carries, or a power of it. */
static double carried(double motor, double power)
{
    return power > 0 ? 0.4 * pow(fabs(motor) / 0.4, power) : fabs(motor);
}

/* How far the encoder is ahead once the motor has moved on. */
static double led(const Plant *p, double lead, double moved)
{
    const double half = 0.5 * p->encoder_play_play, n = p->encoder_play_rounding;
    if (n > 0 && lead * moved < 0) moved *= 1 - pow(fmin(fabs(lead) / half, 1), n);
    return fmax(-half, fmin(half, lead - moved));
}

/* Level at which the bristles slide. */
static double level(const Plant *p, double theta, double v, double drift, double motor)
{
    double factor = (1 + p->asymmetric_coulomb_share * sign(v)) * drift, added = 0;
    if (p->stribeck_excess != 0) {
        const double x = fabs(v) / p->stribeck_speed;
        const double fall = p->stribeck_kind == 0 ? exp(-x * x) : p->stribeck_kind == 1 ? exp(-x) : 1 / (1 + x * x);
        factor *= 1 + p->stribeck_excess * fall;
    }
    if (p->position_friction_amplitude != 0) {
        const double angle = p->position_friction_periods * theta;
        double wave = sin(angle + p->position_friction_phase);
        if (p->position_friction_second != 0)
            wave += p->position_friction_second * sin(2 * angle + p->position_friction_second_phase);
        factor *= 1 + p->position_friction_amplitude * wave;
    }
    if (p->load_friction_coefficient > 0) {
        double share = p->load_friction_coefficient;
        if (p->load_friction_kind == 1) share += p->load_friction_falling * exp(-square(v / p->load_friction_speed));
        added = share * carried(motor, p->load_friction_power);
    }
    if (p->gear_loss_driving > 0 || p->gear_loss_driven > 0) /* at rest it is about to drive */
        added += (motor * v < 0 ? p->gear_loss_driven : p->gear_loss_driving) * carried(motor, p->gear_loss_power);
    return fmax(p->Fc * factor + added, 1e-5);
}

/* z' = v - sigma0 |v| z / g over a time, with v and g held: the solution is exact. */
static double relax(double z, double v, double g, double stiffness, double time)
{
    const double end = sign(v) * g / stiffness, rate = fabs(v) * stiffness / g * time;
    return rate > 40 ? end : end + (z - end) * exp(-rate);
}

static double motor_side(const Plant *p, double theta, double v, double t, double hysteresis)
{
    double torque = p->bias_torque;
    if (p->bias_ripple != 0) torque *= 1 + p->bias_ripple * sin(0.5 * theta + p->bias_ripple_phase);
    if (p->quadratic_drag_coefficient != 0) {
        const double e = p->quadratic_drag_exponent;
        torque -= p->quadratic_drag_coefficient * sign(v) * (e > 0 ? pow(fabs(v), e) : v * v);
    }
    if (p->cogging_amplitude != 0) {
        const double angle = p->cogging_periods * theta;
        double wave = sin(angle + p->cogging_phase);
        if (p->cogging_steep > 0) wave = tanh(p->cogging_steep * wave) / tanh(p->cogging_steep);
        if (p->cogging_third != 0) wave += p->cogging_third * sin(3 * angle + p->cogging_third_phase);
        torque += p->cogging_amplitude * wave;
        if (p->cogging_amplitude2 != 0) torque += p->cogging_amplitude2 * sin(2 * angle + p->cogging_phase2);
    }
    if (p->tone_amplitude != 0) torque += p->tone_amplitude * sin(p->tone_frequency * t + p->tone_phase);
    if (p->burst_amplitude != 0) {
        const double since = fmod(t + p->burst_spacing - p->burst_start, p->burst_spacing) - 0.5 * p->burst_spacing;
        const double w = p->burst_frequency;
        torque += p->burst_amplitude * exp(-square(since / p->burst_width)) * (sin(w * t) + 0.6 * sin(1.618034 * w * t));
    }
    if (p->asymmetric_viscous_coefficient != 0) {
        const double e = p->asymmetric_viscous_power;
        torque -= p->asymmetric_viscous_coefficient * (e > 0 ? 5 * pow(fabs(v) / 5, e) : fabs(v));
    }
    return torque - p->hysteresis_torque * hysteresis - p->asymmetric_coulomb_viscous * p->a2 * fabs(v);
}

static double stop_torque(const Plant *p, double depth, double rate)
{
    if (depth <= 0) return 0;
    if (p->hard_stop_kind == 1) return p->hard_stop_stiffness * depth * depth / 0.05;
    const double torque = p->hard_stop_stiffness * depth;
    return p->hard_stop_kind == 2 ? fmax(torque + p->hard_stop_damping * rate, 0) : torque;
}

static double load_side(const Plant *p, double theta, double v, double t)
{
    double torque = 0;
    if (p->gravity_amplitude != 0) {
        torque -= p->gravity_amplitude * sin(theta + p->gravity_phase);
        if (p->gravity_second != 0)
            torque -= p->gravity_amplitude * p->gravity_second * sin(2 * theta + p->gravity_second_phase);
    }
    if (p->return_spring_stiffness > 0) {
        const double stretch = theta - p->return_spring_rest;
        torque -= p->return_spring_stiffness * stretch * (1 + p->return_spring_stiffening * stretch * stretch);
    }
    if (p->hard_stop_stiffness > 0)
        torque += stop_torque(p, p->hard_stop_lower - theta, -v) - stop_torque(p, theta - p->hard_stop_upper, v);
    if (p->disturbance_step_torque != 0 && t > p->disturbance_step_onset) {
        const double x = (t - p->disturbance_step_onset) / p->disturbance_step_rise;
        torque += p->disturbance_step_torque * (p->disturbance_step_kind == 1 ? 1 - exp(-x) : fmin(x, 1));
    }
    return torque;
}

static double coupling(const Plant *p, double twist, double rate)
{
    if (p->compliance_share > 0)
        return p->compliance_stiffness * twist * (1 + p->compliance_stiffening * twist * twist) + p->compliance_damping * rate;
    const double half = 0.5 * p->backlash_play, deep = fabs(twist) - half;
    if (deep <= 0) return 0;
    const double side = sign(twist), exponent = p->backlash_hertz;
    const double elastic = p->backlash_stiffness * (exponent > 0 ? 0.005 * pow(deep / 0.005, exponent) : deep);
    return side * elastic * fmax(0, 1 + p->backlash_dissipation * rate * side);
}

/* One internal step. torque: what the motor is asked for over the step; noise: disturbance torque. Half a step of positions
   and hidden states, a whole one of velocities, another half: second order (strang1968). */
static void advance(const Plant *p, double *x, double t, double asked, double noise)
{
    const double h = p->step, half = 0.5 * h, lag = p->electrical_pole_time_constant;
    const int soft = p->presliding_stiffness > 0, damped = p->bristle_damping_stiffness > 0;
    const int two = p->compliance_share > 0 || p->backlash_share > 0;
    const double share = p->compliance_share + p->backlash_share;
    const double split = soft ? p->presliding_split : 0;
    const double stiff = soft ? p->presliding_stiffness : damped ? p->bristle_damping_stiffness : p->sigma0;
    const double stiff2 = stiff * p->presliding_ratio;
    const double fade = damped ? p->bristle_damping_fade : p->sigma1_speed;
    double sigma1 = damped ? p->bristle_damping_damping : soft ? 0 : p->sigma1;
    const double drift = drifted(p, t + half);
    double motor = asked, g = 0; /* the motor's torque, and the level of friction */
    const double keep = lag > 0 ? exp(-half / (p->electrical_pole_order == 2 ? 0.5 * lag : lag)) : 0;

    for (int part = 0; part < 2; part++) {
        x[THETA] += half * x[V];
        if (p->encoder_play_play > 0) x[LEAD] = led(p, x[LEAD], half * x[V]);
        if (two) x[THETA_LOAD] += half * x[V_LOAD];
        motor = asked;
        if (lag > 0) {
            x[LAG] = asked + (x[LAG] - asked) * keep;
            motor = x[LAG];
            if (p->electrical_pole_order == 2) motor = x[LAG2] = x[LAG] + (x[LAG2] - x[LAG]) * keep;
        }
        if (p->torque_ripple_share != 0) {
            const double angle = p->torque_ripple_periods * x[THETA];
            double wave = sin(angle + p->torque_ripple_phase);
            wave += p->torque_ripple_second * sin(2 * angle + p->torque_ripple_second_phase);
            motor *= 1 + p->torque_ripple_share * wave;
        }
        if (p->hysteresis_torque != 0) {
            const double q = x[HYSTERESIS];
            x[HYSTERESIS] += half * x[V] / p->hysteresis_travel * (q * x[V] > 0 ? 1 - fabs(q) : 1);
        }
        if (p->regular == 0) {
            g = level(p, x[THETA], x[V], drift, motor);
            x[Z] = relax(x[Z], x[V], (1 - split) * g, stiff, half);
            if (split > 0) x[ZB] = relax(x[ZB], x[V], split * g, stiff2, half);
        }
        if (part == 1) break;

        double inertia = p->J, other = motor_side(p, x[THETA], x[V], t + half, x[HYSTERESIS]) + motor + noise;
        if (p->inertia_ripple_share != 0) {
            const double n = p->inertia_ripple_periods, angle = n * x[THETA] + p->inertia_ripple_phase;
            inertia *= 1 + p->inertia_ripple_share * sin(angle);
            other -= 0.5 * p->J * p->inertia_ripple_share * n * cos(angle) * x[V] * x[V];
        }
        if (two) {
            const double link = coupling(p, x[THETA] - x[THETA_LOAD], x[V] - x[V_LOAD]);
            const double load = load_side(p, x[THETA_LOAD], x[V_LOAD], t + half);
            x[V_LOAD] += h * (load + link) / (share * p->J);
            other -= link;
            inertia = (1 - share) * p->J;
        } else {
            other += load_side(p, x[THETA], x[V], t + half);
        }
        double viscous = p->a2 * (1 + p->viscous_drift_rate * (t + half));
        if (p->regular > 0) { /* v+ solves v+ = a - b v+/(|v+| + w): a quadratic equation */
            const double a = x[V] + h / inertia * (other - viscous * x[V]), b = h / inertia * p->Fc * drift, w = p->regular;
            const double m = fabs(a) - b - w;
            x[V] = sign(a) * 0.5 * (m + sqrt(m * m + 4 * w * fabs(a)));
            continue;
        }
        if (fade > 0) sigma1 *= exp(-square(x[V] / fade));
        viscous += sigma1 * fmax(1 - stiff * x[Z] * sign(x[V]) / ((1 - split) * g), 0);
        const double c = half * viscous / inertia;
        const double force = stiff * x[Z] + (split > 0 ? stiff2 * x[ZB] : 0);
        x[V] = (x[V] * (1 - c) + h / inertia * (other - force)) / (1 + c);
    }
}

/* One sampling period from sample k; at0: session time of sample 0; w: disturbance at the samples, or null. */
static void period(const Plant *p, double *x, double at0, long k, const double *u, const double *w)
{
    const long steps = lround(PERIOD / p->step);
    double asked = drive(p, command(p, u[k]));
    for (long i = 0; i < steps; i++) {
        const double at = (double)k * PERIOD + (double)i * p->step;
        if (p->input_delay_delay > 0) {
            const double late = p->input_delay_delay * (1 + p->input_delay_jitter * jitter(lround(floor(100 * at + 1e-9))));
            asked = drive(p, command(p, held(u, at + 1e-12 - late, p->step)));
        }
        const double part = ((double)i + 0.5) / (double)steps;
        advance(p, x, at0 + at, asked, w ? w[k] + part * (w[k + 1] - w[k]) : 0);
    }
}

static double shown(const Plant *p, const double *x)
{
    double theta = x[THETA];
    if (p->eccentric_encoder_amplitude != 0) {
        theta += p->eccentric_encoder_amplitude * sin(x[THETA] + p->eccentric_encoder_phase);
        if (p->eccentric_encoder_second != 0)
            theta += p->eccentric_encoder_amplitude * p->eccentric_encoder_second
                   * sin(2 * x[THETA] + p->eccentric_encoder_second_phase);
    }
    return theta + x[LEAD];
}

EXPORT int truth_states(void) { return STATES; }

/* Closed loop over n samples; reference: n rows of position, velocity, acceleration; kept: the states at every sample. */
EXPORT void truth_run(const Plant *p, const Loop *c, double at0, long n, const double *reference, const double *w,
                      const double *start, double *y, double *u, double *kept)
{
    double x[STATES], before = 0, slope = 0, speed = 0, integral = 0;
    for (int i = 0; i < STATES; i++) x[i] = start[i];
    for (long k = 0; k < n; k++) {
        const double *r = reference + 3 * k, a = PERIOD / (PERIOD + c->filter);
        y[k] = c->resolution * floor(shown(p, x) / c->resolution);
        slope += a * ((k ? y[k] - before : 0) / PERIOD - slope);
        speed += a * (slope - speed);
        before = y[k];
        const double error = r[0] - y[k];
        const double forward = c->forward_J * r[2] + c->forward_a2 * r[1] + c->forward_Fc * tanh(r[1] / 0.05);
        const double wish = c->kp * error + c->kd * (r[1] - speed) + integral + forward;
        u[k] = fmax(-c->limit, fmin(c->limit, wish));
        if (u[k] == wish && fabs(error) > 3 * c->resolution) integral += c->ki * error * PERIOD;
        for (int i = 0; i < STATES; i++) kept[k * STATES + i] = x[i];
        if (k < n - 1) period(p, x, at0, k, u, w);
    }
}

/* Replay without disturbance of `count` pieces of `length` samples: from sample first[i] and its own state. */
EXPORT void truth_replay(const Plant *p, double at0, long count, long length, const long long *first, const double *u,
                         const double *states, double *y)
{
    for (long i = 0; i < count; i++) {
        double x[STATES];
        for (int j = 0; j < STATES; j++) x[j] = states[i * STATES + j];
        for (long k = 0; k < length; k++) {
            y[i * length + k] = shown(p, x);
            if (k < length - 1) period(p, x, at0, (long)first[i] + k, u, NULL);
        }
    }
}

/* Open loop: the input u is played back under a disturbance w; the encoder rounds down. */
EXPORT void truth_play(const Plant *p, double resolution, double at0, long n, const double *u, const double *w,
                       const double *start, double *y)
{
    double x[STATES];
    for (int i = 0; i < STATES; i++) x[i] = start[i];
    for (long k = 0; k < n; k++) {
        y[k] = resolution * floor(shown(p, x) / resolution);
        if (k < n - 1) period(p, x, at0, k, u, w);
    }
}
