/* What the estimator computes a hundred times a second: the motion of its state and the vehicle model as a sensor, each
 * with its Jacobian.
 *
 * The same numbers as estimator/motion.py and estimator/measure_model.py, which say what they mean and stand in where
 * there is no library. tests/estimator/test_compiled_models.py holds them against each other.
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

typedef struct {
    double x[NX];
    double yaw_rate, thrust[MOST_THRUSTERS];
    double mass[4], linear[4], quadratic[4], buoyancy_excess, follow[2], smoothing; /* of the vehicle */
    double allocation[4][MOST_THRUSTERS];
    double acceleration[4]; /* over ground forward, right, down; of the yaw rate */
    double jacobian[3][NX]; /* zero but for what is written here */
} ModelStruct;
LAYOUT(ModelStruct, x, yaw_rate, thrust, mass, linear, quadratic, buoyancy_excess, follow, smoothing, allocation, acceleration,
       jacobian)

/* d(|a| a)/da, smoothed. */
static double slope(double a, double smoothing) {
    const double a2 = a * a;
    return (2.0 * a2 + smoothing) / sqrt(a2 + smoothing);
}

EXPORT void model_look(ModelStruct *t) {
    const double *x = t->x, *m = t->mass, *follow = t->follow;
    const double c = cos(x[YAW]), s = sin(x[YAW]);
    const double rn = x[VEL_NORTH] - x[CURRENT_NORTH], re = x[VEL_EAST] - x[CURRENT_EAST];
    const double u = c * rn + s * re, v = c * re - s * rn, w = x[VEL_DOWN] - x[CURRENT_DOWN];
    const double r = t->yaw_rate - x[GYRO_BIAS], nu[4] = {u, v, w, r};
    double force[4], drag[4];
    for (int i = 0; i < 4; i++) {
        force[i] = 0.0;
        for (int j = 0; j < MOST_THRUSTERS; j++) force[i] += t->allocation[i][j] * t->thrust[j];
        drag[i] = t->linear[i] * nu[i] + t->quadratic[i] * sqrt(nu[i] * nu[i] + t->smoothing) * nu[i];
    }
    const double gn = x[CURRENT_RATE_NORTH], ge = x[CURRENT_RATE_EAST];
    const double drag_u = drag[0] / m[0], drag_v = drag[1] / m[1], push_u = force[0] / m[0], push_v = force[1] / m[1];
    const double du = (force[0] - drag[0] + m[1] * v * r) / m[0], dv = (force[1] - drag[1] - m[0] * u * r) / m[1];
    t->acceleration[0] = du - r * v - x[DRAG_EXCESS] * drag_u + x[THRUST_EXCESS] * push_u
                         + follow[0] * (c * gn + s * ge);
    t->acceleration[1] = dv + r * u - x[DRAG_EXCESS] * drag_v + x[THRUST_EXCESS] * push_v
                         + follow[1] * (c * ge - s * gn);
    t->acceleration[2] = (force[2] - drag[2] - t->buoyancy_excess) / m[2];
    t->acceleration[3] = (force[3] - drag[3] + (m[0] - m[1]) * u * v) / m[3];
    const double more = 1.0 + x[DRAG_EXCESS];
    const double fu = -more * (t->linear[0] + t->quadratic[0] * slope(u, t->smoothing)) / m[0];
    const double fv = -more * (t->linear[1] + t->quadratic[1] * slope(v, t->smoothing)) / m[1];
    const double fw = -(t->linear[2] + t->quadratic[2] * slope(w, t->smoothing)) / m[2];
    const double by_v = m[1] / m[0] - 1.0, by_u = 1.0 - m[0] / m[1], cross_v = by_v * r, cross_u = by_u * r;
    double *ahead = t->jacobian[0], *right = t->jacobian[1], *down = t->jacobian[2];
    /* Through u_r = c rn + s re and v_r = c re - s rn, with d u_r/d yaw = v_r and d v_r/d yaw = -u_r. */
    ahead[VEL_NORTH] = fu * c - cross_v * s;
    ahead[VEL_EAST] = fu * s + cross_v * c;
    right[VEL_NORTH] = cross_u * c - fv * s;
    right[VEL_EAST] = cross_u * s + fv * c;
    ahead[CURRENT_NORTH] = -ahead[VEL_NORTH];
    ahead[CURRENT_EAST] = -ahead[VEL_EAST];
    right[CURRENT_NORTH] = -right[VEL_NORTH];
    right[CURRENT_EAST] = -right[VEL_EAST];
    ahead[YAW] = fu * v - cross_v * u + follow[0] * (c * ge - s * gn);
    right[YAW] = cross_u * v - fv * u - follow[1] * (c * gn + s * ge);
    ahead[GYRO_BIAS] = -by_v * v;
    right[GYRO_BIAS] = -by_u * u;
    ahead[BIAS_AHEAD] = right[BIAS_RIGHT] = down[BIAS_DOWN] = 1.0;
    ahead[DRAG_EXCESS] = -drag_u;
    right[DRAG_EXCESS] = -drag_v;
    ahead[THRUST_EXCESS] = push_u;
    right[THRUST_EXCESS] = push_v;
    ahead[CURRENT_RATE_NORTH] = follow[0] * c;
    ahead[CURRENT_RATE_EAST] = follow[0] * s;
    right[CURRENT_RATE_NORTH] = -follow[1] * s;
    right[CURRENT_RATE_EAST] = follow[1] * c;
    down[VEL_DOWN] = fw;
    down[CURRENT_DOWN] = -fw;
}
