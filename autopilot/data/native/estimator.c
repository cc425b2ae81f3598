/* What the estimator computes a hundred times a second: the motion of its state and the vehicle model as a sensor, each
 * with its Jacobian, and the covariance of the Kalman filter.
 *
 * The same numbers as estimator/motion.py, estimator/measure_model.py and filterpy, which say what they mean and stand
 * in where there is no library. tests/estimator/test_compiled_models.py holds them against each other.
 */
#include <math.h>
#include <string.h>

#include "common.h"

enum { NX = 21, MOST_THRUSTERS = 8 };
enum {
    NORTH, EAST, DOWN, YAW, VEL_NORTH, VEL_EAST, VEL_DOWN, GYRO_BIAS, BIAS_AHEAD, BIAS_RIGHT, BIAS_DOWN,
    CURRENT_NORTH, CURRENT_EAST, CURRENT_RATE_NORTH, CURRENT_RATE_EAST, HEADING_OFFSET, LASER_BIAS, DRAG_EXCESS,
    CURRENT_DOWN, DEPTH_OFFSET, THRUST_EXCESS
};

typedef struct {
    double x[NX];
    double dt_s, yaw_rate, accel[3], fade_s; /* the step: means, level frame; time constant of the current's rate */
    double moved[NX];
    double jacobian[NX][NX]; /* the identity but for what is written here */
} Motion;
LAYOUT(Motion, x, dt_s, yaw_rate, accel, fade_s, moved, jacobian)

EXPORT void motion_step(Motion *t) {
    const double *x = t->x, dt = t->dt_s, half = 0.5 * dt * dt;
    const double c = cos(x[YAW]), s = sin(x[YAW]);
    const double fx = t->accel[0] - x[BIAS_AHEAD], fy = t->accel[1] - x[BIAS_RIGHT];
    const double an = c * fx - s * fy, ae = s * fx + c * fy, ad = t->accel[2] - x[BIAS_DOWN];
    const double fade = exp(-dt / t->fade_s);
    const double cdt = c * dt, sdt = s * dt, chalf = c * half, shalf = s * half;
    double *y = t->moved;
    double(*f)[NX] = t->jacobian;
    memcpy(y, x, sizeof t->x);
    y[NORTH] = x[NORTH] + x[VEL_NORTH] * dt + half * an;
    y[EAST] = x[EAST] + x[VEL_EAST] * dt + half * ae;
    y[DOWN] = x[DOWN] + x[VEL_DOWN] * dt + half * ad;
    y[YAW] = x[YAW] + (t->yaw_rate - x[GYRO_BIAS]) * dt;
    y[VEL_NORTH] = x[VEL_NORTH] + an * dt;
    y[VEL_EAST] = x[VEL_EAST] + ae * dt;
    y[VEL_DOWN] = x[VEL_DOWN] + ad * dt;
    y[CURRENT_NORTH] = x[CURRENT_NORTH] + x[CURRENT_RATE_NORTH] * dt;
    y[CURRENT_EAST] = x[CURRENT_EAST] + x[CURRENT_RATE_EAST] * dt;
    y[CURRENT_RATE_NORTH] = fade * x[CURRENT_RATE_NORTH];
    y[CURRENT_RATE_EAST] = fade * x[CURRENT_RATE_EAST];
    f[NORTH][VEL_NORTH] = f[EAST][VEL_EAST] = f[DOWN][VEL_DOWN] = dt;
    f[NORTH][YAW] = -half * ae;
    f[NORTH][BIAS_AHEAD] = -chalf;
    f[NORTH][BIAS_RIGHT] = shalf;
    f[EAST][YAW] = half * an;
    f[EAST][BIAS_AHEAD] = -shalf;
    f[EAST][BIAS_RIGHT] = -chalf;
    f[DOWN][BIAS_DOWN] = -half;
    f[YAW][GYRO_BIAS] = -dt;
    f[VEL_NORTH][YAW] = -dt * ae;
    f[VEL_NORTH][BIAS_AHEAD] = -cdt;
    f[VEL_NORTH][BIAS_RIGHT] = sdt;
    f[VEL_EAST][YAW] = dt * an;
    f[VEL_EAST][BIAS_AHEAD] = -sdt;
    f[VEL_EAST][BIAS_RIGHT] = -cdt;
    f[VEL_DOWN][BIAS_DOWN] = -dt;
    f[CURRENT_NORTH][CURRENT_RATE_NORTH] = f[CURRENT_EAST][CURRENT_RATE_EAST] = dt;
    f[CURRENT_RATE_NORTH][CURRENT_RATE_NORTH] = f[CURRENT_RATE_EAST][CURRENT_RATE_EAST] = fade;
}

/* F P F' + Q, all (NX, NX) but for the diagonal Q: F is sparse. */
EXPORT void spread_step(const double *f, const double *p, const double *noise, double *after) {
    double fp[NX][NX] = {{0.0}};
    for (int i = 0; i < NX; i++)
        for (int k = 0; k < NX; k++) {
            const double by = f[NX * i + k];
            if (by == 0.0) continue;
            for (int j = 0; j < NX; j++) fp[i][j] += by * p[NX * k + j];
        }
    memset(after, 0, sizeof fp);
    for (int j = 0; j < NX; j++) {
        for (int k = 0; k < NX; k++) {
            const double by = f[NX * j + k];
            if (by == 0.0) continue;
            for (int i = 0; i < NX; i++) after[NX * i + j] += fp[i][k] * by;
        }
        after[NX * j + j] += noise[j];
    }
}

enum { MOST_RESIDUALS = 24 };

typedef struct {
    long m;
    double x[NX], p[NX * NX];                       /* before and after */
    double residual[MOST_RESIDUALS];                /* (m) and so on: the first entries are used */
    double jacobian[MOST_RESIDUALS * NX];           /* (m, NX) */
    double shared[NX * MOST_RESIDUALS];             /* (NX, m) covariance of the state with the noise; then the gain */
    double noise[MOST_RESIDUALS * MOST_RESIDUALS];  /* (m, m) that the state has no part in; then of the residual */
    double inverse[MOST_RESIDUALS * MOST_RESIDUALS]; /* (m, m) of the residual's covariance */
    double distance2;
} Update;
LAYOUT(Update, m, x, p, residual, jacobian, shared, noise, inverse, distance2)

/* Kalman's update with Joseph's covariance, P - K (P H')' - (P H') K' + K S K'; 0 if S is not positive definite. */
EXPORT long kalman_update(Update *t) {
    const long m = t->m;
    double spread[NX * MOST_RESIDUALS], root[MOST_RESIDUALS * MOST_RESIDUALS], half[NX * MOST_RESIDUALS];
    for (int i = 0; i < NX; i++)
        for (long a = 0; a < m; a++) {
            double sum = t->shared[m * i + a];
            for (int k = 0; k < NX; k++) sum += t->p[NX * i + k] * t->jacobian[NX * a + k];
            spread[m * i + a] = sum;
        }
    for (long a = 0; a < m; a++)
        for (long b = 0; b < m; b++) {
            double sum = t->noise[m * a + b];
            for (int k = 0; k < NX; k++)
                sum += t->jacobian[NX * a + k] * spread[m * k + b];
            t->inverse[m * a + b] = sum;
        }
    for (long i = 0; i < m * m; i++) t->noise[i] = t->inverse[i];
    for (long i = 0; i < m; i++) /* S = L L', then the inverse of L in its place */
        for (long j = 0; j <= i; j++) {
            double sum = 0.5 * (t->noise[m * i + j] + t->noise[m * j + i]);
            for (long k = 0; k < j; k++) sum -= root[m * i + k] * root[m * j + k];
            if (i != j)
                root[m * i + j] = sum / root[m * j + j];
            else if (sum > 0.0)
                root[m * i + i] = sqrt(sum);
            else
                return 0;
        }
    for (long j = 0; j < m; j++) {
        root[m * j + j] = 1.0 / root[m * j + j];
        for (long i = j + 1; i < m; i++) {
            double sum = 0.0;
            for (long k = j; k < i; k++) sum -= root[m * i + k] * root[m * k + j];
            root[m * i + j] = sum / root[m * i + i];
        }
    }
    t->distance2 = 0.0;
    for (long i = 0; i < m; i++) {
        double off = 0.0;
        for (long j = 0; j <= i; j++) off += root[m * i + j] * t->residual[j];
        t->distance2 += off * off;
        for (long j = 0; j <= i; j++) {
            double sum = 0.0;
            for (long k = i; k < m; k++) sum += root[m * k + i] * root[m * k + j];
            t->inverse[m * i + j] = t->inverse[m * j + i] = sum;
        }
    }
    for (int i = 0; i < NX; i++) {
        double *gain = t->shared + m * i;
        for (long a = 0; a < m; a++) {
            double sum = 0.0;
            for (long b = 0; b < m; b++) sum += spread[m * i + b] * t->inverse[m * b + a];
            gain[a] = sum;
        }
        for (long a = 0; a < m; a++) {
            double sum = 0.0;
            for (long b = 0; b < m; b++) sum += gain[b] * t->noise[m * b + a];
            half[m * i + a] = spread[m * i + a] - 0.5 * sum;
            t->x[i] += gain[a] * t->residual[a];
        }
    }
    for (int i = 0; i < NX; i++)
        for (int j = 0; j <= i; j++) {
            double less = 0.0;
            for (long a = 0; a < m; a++)
                less += t->shared[m * i + a] * half[m * j + a] + half[m * i + a] * t->shared[m * j + a];
            t->p[NX * i + j] = t->p[NX * j + i] = 0.5 * (t->p[NX * i + j] + t->p[NX * j + i]) - less;
        }
    return 1;
}

typedef struct {
    double x[NX];
    double tilt[2], rate[3], thrust[MOST_THRUSTERS];        /* roll and pitch; of the gyros */
    double mass[4], linear[4], quadratic[4], buoyancy_excess, follow[2], smoothing; /* of the vehicle */
    double allocation[4][MOST_THRUSTERS];
    double acceleration[4]; /* over ground forward, right, down in the level frame; of the yaw rate */
    double jacobian[3][NX]; /* zero but for what is written here */
} ModelStruct;
LAYOUT(ModelStruct, x, tilt, rate, thrust, mass, linear, quadratic, buoyancy_excess, follow, smoothing, allocation,
       acceleration, jacobian)

/* d(|a| a)/da, smoothed. */
static double slope(double a, double smoothing) {
    const double a2 = a * a;
    return (2.0 * a2 + smoothing) / sqrt(a2 + smoothing);
}

/* A share that drag or thrust exceeds the model's by: below the first it would drive the vehicle instead of braking it,
 * above the second it is no vehicle of this file (estimator/measure_model.py). */
static double share(double excess) {
    return excess < -0.8 ? -0.8 : excess > 4.0 ? 4.0 : excess;
}

/* a x b */
static void cross(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* R a, or R' a. */
static void turn(const double (*R)[3], int back, const double *a, double *out) {
    for (int i = 0; i < 3; i++) {
        out[i] = 0.0;
        for (int j = 0; j < 3; j++) out[i] += (back ? R[j][i] : R[i][j]) * a[j];
    }
}

EXPORT void model_look(ModelStruct *t) {
    const double *x = t->x, *m = t->mass;
    const double c = cos(x[YAW]), s = sin(x[YAW]);
    const double cr = cos(t->tilt[0]), sr = sin(t->tilt[0]), cp = cos(t->tilt[1]), sp = sin(t->tilt[1]);
    const double R[3][3] = {{cp, sp * sr, sp * cr}, {0.0, cr, -sr}, {-sp, cp * sr, cp * cr}}; /* level from FRD */
    const double rn = x[VEL_NORTH] - x[CURRENT_NORTH], re = x[VEL_EAST] - x[CURRENT_EAST];
    const double level[3] = {c * rn + s * re, c * re - s * rn, x[VEL_DOWN] - x[CURRENT_DOWN]};
    const double rate[3] = {t->rate[0], t->rate[1], t->rate[2] - x[GYRO_BIAS]};
    const double excess = share(x[DRAG_EXCESS]), stronger = share(x[THRUST_EXCESS]);
    double nu[4], momentum[3], lever[3], carried[3], accel[3], drag[3], push[3];
    turn(R, 1, level, nu);
    nu[3] = rate[2];
    for (int i = 0; i < 3; i++) momentum[i] = m[i] * nu[i];
    cross(rate, momentum, lever);
    cross(rate, nu, carried);
    double force[4], brake[4];
    for (int i = 0; i < 4; i++) {
        force[i] = 0.0;
        for (int j = 0; j < MOST_THRUSTERS; j++) force[i] += t->allocation[i][j] * t->thrust[j];
        brake[i] = t->linear[i] * nu[i] + t->quadratic[i] * sqrt(nu[i] * nu[i] + t->smoothing) * nu[i];
    }
    for (int i = 0; i < 3; i++) {
        const double planar = i < 2 ? 1.0 : 0.0; /* the shares are of surge and sway */
        drag[i] = planar * brake[i] / m[i];
        push[i] = planar * force[i] / m[i];
        accel[i] = (force[i] - brake[i] - R[2][i] * t->buoyancy_excess - lever[i]) / m[i] + carried[i] - excess * drag[i]
                   + stronger * push[i];
    }
    turn(R, 0, accel, t->acceleration);
    const double gn = x[CURRENT_RATE_NORTH], ge = x[CURRENT_RATE_EAST];
    t->acceleration[0] += t->follow[0] * (c * gn + s * ge);
    t->acceleration[1] += t->follow[1] * (c * ge - s * gn);
    t->acceleration[3] = (force[3] - brake[3] + (m[0] - m[1]) * nu[0] * nu[1]) / m[3];
    /* By the velocity in the body, then in the level frame. */
    double in_body[3][3], half[3][3], by[3][3];
    for (int j = 0; j < 3; j++) {
        double unit[3] = {0.0}, heavy[3] = {0.0}, less[3], more[3];
        unit[j] = 1.0;
        heavy[j] = m[j];
        cross(rate, heavy, less);
        cross(rate, unit, more);
        for (int i = 0; i < 3; i++) in_body[i][j] = more[i] - less[i] / m[i];
        in_body[j][j] -= (j < 2 ? 1.0 + excess : 1.0) * (t->linear[j] + t->quadratic[j] * slope(nu[j], t->smoothing)) / m[j];
    }
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 3; i++) {
            half[i][j] = 0.0;
            for (int k = 0; k < 3; k++) half[i][j] += R[i][k] * in_body[k][j];
        }
    for (int i = 0; i < 3; i++) turn(R, 0, half[i], by[i]); /* row i of half R' */
    /* By the gyro's bias: -down x (M nu) / M + down x nu. */
    const double bias[3] = {nu[1] - m[1] * nu[1] / m[0], m[0] * nu[0] / m[1] - nu[0], 0.0};
    double by_bias[3], by_drag[3], by_push[3];
    turn(R, 0, bias, by_bias);
    turn(R, 0, drag, by_drag);
    turn(R, 0, push, by_push);
    for (int i = 0; i < 3; i++) {
        double *row = t->jacobian[i];
        row[VEL_NORTH] = c * by[i][0] - s * by[i][1];
        row[VEL_EAST] = s * by[i][0] + c * by[i][1];
        row[VEL_DOWN] = by[i][2];
        row[CURRENT_NORTH] = -row[VEL_NORTH];
        row[CURRENT_EAST] = -row[VEL_EAST];
        row[CURRENT_DOWN] = -row[VEL_DOWN];
        row[YAW] = by[i][0] * level[1] - by[i][1] * level[0]; /* d u_r/d yaw = v_r, d v_r/d yaw = -u_r */
        row[GYRO_BIAS] = by_bias[i];
        row[DRAG_EXCESS] = -by_drag[i];
        row[THRUST_EXCESS] = by_push[i];
    }
    double *ahead = t->jacobian[0], *right = t->jacobian[1];
    ahead[YAW] += t->follow[0] * (c * ge - s * gn);
    right[YAW] -= t->follow[1] * (c * gn + s * ge);
    ahead[CURRENT_RATE_NORTH] = t->follow[0] * c;
    ahead[CURRENT_RATE_EAST] = t->follow[0] * s;
    right[CURRENT_RATE_NORTH] = -t->follow[1] * s;
    right[CURRENT_RATE_EAST] = t->follow[1] * c;
    ahead[BIAS_AHEAD] = right[BIAS_RIGHT] = t->jacobian[2][BIAS_DOWN] = 1.0;
}
