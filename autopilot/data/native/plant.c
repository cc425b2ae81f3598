/* A step of the simulated hull, and what is measured of it.
 *
 * The same numbers, bit for bit, as sitl/rigid_body.py, sitl/thruster_models.py and sitl/tether.py, which say what they mean
 * and stay for everything else: a hull that may touch something, and machines without this library.
 * tests/sitl/test_compiled_plant.py holds them against each other. Nothing here is shared with the controller's model.
 */
#include <math.h>

#include "common.h"

#if defined(__clang__) /* GCC does not contract in ISO C */
#pragma STDC FP_CONTRACT OFF
#endif

enum { STATES = 13, MOST_THRUSTERS = 8 };

/* As sitl/compiled_hull.py lays it out. */
typedef struct {
    double mass, added[3], inertia[3]; /* inertia: of hull and added water */
    double linear[3], quadratic[3], turn_linear[3], turn_quadratic[3];
    double weight, buoyancy, displaced, center[3], half_height;
    double tethered, entry[3], tether_drag, tether_pull, slack;
    double columns[MOST_THRUSTERS][6], tau[MOST_THRUSTERS], ahead_power[MOST_THRUSTERS], astern_power[MOST_THRUSTERS];
    double thrusters;
} HullStruct;
LAYOUT(HullStruct, mass, added, inertia, linear, quadratic, turn_linear, turn_quadratic, weight, buoyancy, displaced, center,
       half_height, tethered, entry, tether_drag, tether_pull, slack, columns, tau, ahead_power, astern_power, thrusters)

typedef struct {
    double state[STATES], change[STATES]; /* `change`: without thrust, see plant_look */
    double motor[MOST_THRUSTERS], gain[MOST_THRUSTERS], goal[MOST_THRUSTERS], mean[MOST_THRUSTERS];
    double power;
    double external[9];
    double current[3], place[2], varies, gradient[4], rate[3]; /* the water, 13 in a row */
    double held, gravity;
    double numbers[25 + MOST_THRUSTERS];
} Hull;
LAYOUT(Hull, state, change, motor, gain, goal, mean, power, external, current, place, varies, gradient, rate, held, gravity,
       numbers)

static inline double larger(double a, double b) { return b > a ? b : a; }

static void derivative(const HullStruct *c, const Hull *h, const double *s, double elapsed, const double *wrench,
                       double *slope) {
    const double x = s[0], y = s[1], z = s[2], ew = s[3], ex = s[4], ey = s[5], ez = s[6];
    const double u = s[7], v = s[8], w = s[9], p = s[10], q = s[11], r = s[12];
    double fx = wrench[0], fy = wrench[1], fz = wrench[2], kx = wrench[3], ky = wrench[4], kz = wrench[5];
    double fn = wrench[6], fe = wrench[7], fd = wrench[8];
    const double ax = c->added[0], ay = c->added[1], az = c->added[2], m = c->mass;

    const double x2 = ex + ex, y2 = ey + ey, z2 = ez + ez;
    const double wx = x2 * ew, wy = y2 * ew, wz = z2 * ew;
    const double xx = x2 * ex, xy = x2 * ey, xz = x2 * ez, yy = y2 * ey, yz = y2 * ez, zz = z2 * ez;
    const double r11 = 1.0 - yy - zz, r12 = xy - wz, r13 = xz + wy;
    const double r21 = xy + wz, r22 = 1.0 - xx - zz, r23 = yz - wx;
    const double r31 = xz - wy, r32 = yz + wx, r33 = 1.0 - xx - yy;
    const double vn = r11 * u + r12 * v + r13 * w;
    const double ve = r21 * u + r22 * v + r23 * w;
    const double vd = r31 * u + r32 * v + r33 * w;

    /* Water velocity in the body frame, and forces from its acceleration. */
    double cn = h->current[0], ce = h->current[1], cd = h->current[2];
    if (h->varies != 0.0) {
        const double nn = h->gradient[0], ne = h->gradient[1], en = h->gradient[2], ee = h->gradient[3];
        const double tn = h->rate[0], te = h->rate[1], td = h->rate[2];
        const double dx = x - h->place[0], dy = y - h->place[1], displaced = c->displaced;
        cn += nn * dx + ne * dy + tn * elapsed;
        ce += en * dx + ee * dy + te * elapsed;
        cd += td * elapsed;
        const double hn = nn * vn + ne * ve + tn, he = en * vn + ee * ve + te;
        const double wn = nn * cn + ne * ce + tn, we = en * cn + ee * ce + te;
        fx += ax * (r11 * hn + r21 * he + r31 * td) + displaced * (r11 * wn + r21 * we + r31 * td);
        fy += ay * (r12 * hn + r22 * he + r32 * td) + displaced * (r12 * wn + r22 * we + r32 * td);
        fz += az * (r13 * hn + r23 * he + r33 * td) + displaced * (r13 * wn + r23 * we + r33 * td);
    }
    const double cu = r11 * cn + r21 * ce + r31 * cd;
    const double cv = r12 * cn + r22 * ce + r32 * cd;
    const double cw = r13 * cn + r23 * ce + r33 * cd;
    const double ur = u - cu, vr = v - cv, wr = w - cw;

    /* Weight, buoyancy of the part that is under water, tether: forces given in NED. */
    double lift = c->buoyancy;
    if (z < c->half_height) lift *= larger(0.0, 0.5 + 0.5 * z / c->half_height);
    fd += c->weight - lift;
    if (c->tethered != 0.0) {
        const double rn = vn - cn, re = ve - ce, rd = vd - cd;
        const double an = x - c->entry[0], ae = y - c->entry[1], ad = z - c->entry[2];
        const double drag = c->tether_drag * sqrt(rn * rn + re * re + rd * rd);
        const double pull = c->tether_pull / larger(sqrt(an * an + ae * ae + ad * ad), c->slack);
        fn += -drag * rn - pull * an;
        fe += -drag * re - pull * ae;
        fd += -drag * rd - pull * ad;
    }
    fx += r11 * fn + r21 * fe + r31 * fd;
    fy += r12 * fn + r22 * fe + r32 * fd;
    fz += r13 * fn + r23 * fe + r33 * fd;

    /* Momentum of hull and water that moves along, Coriolis terms, drag. */
    const double mu = ax * ur, mv = ay * vr, mw = az * wr;
    const double gu = m * u + mu, gv = m * v + mv, gw = m * w + mw;
    fx -= q * (gw + ax * cw) - r * (gv + ax * cv) + (c->linear[0] + c->quadratic[0] * fabs(ur)) * ur;
    fy -= r * (gu + ay * cu) - p * (gw + ay * cw) + (c->linear[1] + c->quadratic[1] * fabs(vr)) * vr;
    fz -= p * (gv + az * cv) - q * (gu + az * cu) + (c->linear[2] + c->quadratic[2] * fabs(wr)) * wr;
    double hp = c->inertia[0] * p, hq = c->inertia[1] * q, hr = c->inertia[2] * r;
    const double bx = c->center[0], by = c->center[1], bz = c->center[2];
    kx -= q * hr - r * hq + vr * mw - wr * mv + (c->turn_linear[0] + c->turn_quadratic[0] * fabs(p)) * p +
          lift * (by * r33 - bz * r32);
    ky -= r * hp - p * hr + wr * mu - ur * mw + (c->turn_linear[1] + c->turn_quadratic[1] * fabs(q)) * q +
          lift * (bz * r31 - bx * r33);
    kz -= p * hq - q * hp + ur * mv - vr * mu + (c->turn_linear[2] + c->turn_quadratic[2] * fabs(r)) * r +
          lift * (bx * r32 - by * r31);

    hp = 0.5 * p, hq = 0.5 * q, hr = 0.5 * r;
    slope[0] = vn, slope[1] = ve, slope[2] = vd;
    slope[3] = -ex * hp - ey * hq - ez * hr;
    slope[4] = ew * hp + ey * hr - ez * hq;
    slope[5] = ew * hq + ez * hp - ex * hr;
    slope[6] = ew * hr + ex * hq - ey * hp;
    slope[7] = fx / (m + ax), slope[8] = fy / (m + ay), slope[9] = fz / (m + az);
    slope[10] = kx / c->inertia[0], slope[11] = ky / c->inertia[1], slope[12] = kz / c->inertia[2];
}

/* Force and moment of the thrusters in the body frame. */
static void push_of(const HullStruct *c, const double *thrust, double *push) {
    for (int k = 0; k < 6; k++) push[k] = 0.0;
    for (int i = 0; i < (int)c->thrusters; i++)
        for (int k = 0; k < 6; k++) push[k] += c->columns[i][k] * thrust[i];
}

static double mass_of(const HullStruct *c, int axis) {
    return axis < 3 ? c->mass + c->added[axis] : c->inertia[axis - 3];
}

/* Sets `change` to what holds now. */
EXPORT void plant_look(const HullStruct *c, Hull *h) { derivative(c, h, h->state, 0.0, h->external, h->change); }

/* The thrusters turn for `dt` s towards `goal` N: exact solution of their lag, and the power that they take. */
EXPORT void plant_turn(const HullStruct *c, Hull *h, double dt) {
    h->power = 0.0;
    for (int i = 0; i < (int)c->thrusters; i++) {
        const double tau = c->tau[i], decay = tau == 0.0 ? 0.0 : exp(-dt / tau);
        const double mean_weight = tau == 0.0 ? 0.0 : tau / dt * (1.0 - decay);
        const double error = h->motor[i] - h->goal[i];
        h->motor[i] = h->goal[i] + decay * error;
        h->mean[i] = h->gain[i] * (h->goal[i] + mean_weight * error);
        const double force = fabs(h->motor[i]);
        h->power += (h->motor[i] < 0.0 ? c->astern_power[i] : c->ahead_power[i]) * force * sqrt(force);
    }
}

/* One classical Runge-Kutta step with the mean thrust held, from where plant_look has looked. */
EXPORT void plant_step(const HullStruct *c, Hull *h, double dt) {
    double push[6], wrench[9], first[STATES], at[STATES], k2[STATES], k3[STATES], k4[STATES];
    push_of(c, h->mean, push);
    for (int k = 0; k < 9; k++) wrench[k] = k < 6 ? h->external[k] + push[k] : h->external[k];
    /* The equations are linear in the thrust. */
    for (int k = 0; k < STATES; k++) first[k] = k < 7 ? h->change[k] : h->change[k] + push[k - 7] / mass_of(c, k - 7);
    const double half = 0.5 * dt, sixth = dt / 6.0;
    for (int k = 0; k < STATES; k++) at[k] = h->state[k] + half * first[k];
    derivative(c, h, at, half, wrench, k2);
    for (int k = 0; k < STATES; k++) at[k] = h->state[k] + half * k2[k];
    derivative(c, h, at, half, wrench, k3);
    for (int k = 0; k < STATES; k++) at[k] = h->state[k] + dt * k3[k];
    derivative(c, h, at, dt, wrench, k4);
    double *s = h->state;
    for (int k = 0; k < STATES; k++) s[k] += sixth * (first[k] + 2.0 * (k2[k] + k3[k]) + k4[k]);
    const double scale = pow(s[3] * s[3] + s[4] * s[4] + s[5] * s[5] + s[6] * s[6], -0.5);
    for (int k = 3; k < 7; k++) s[k] *= scale;
}

/* Fills `numbers` with what sitl/plant.py makes a Truth of, from where plant_look has looked. */
EXPORT void plant_measure(const HullStruct *c, Hull *h) {
    const double *s = h->state, *change = h->change;
    double *out = h->numbers;
    const double ew = s[3], ex = s[4], ey = s[5], ez = s[6], u = s[7], v = s[8], w = s[9], p = s[10], q = s[11];
    const double r = s[12], cn = h->current[0], ce = h->current[1], cd = h->current[2];
    const double r11 = 1.0 - 2.0 * (ey * ey + ez * ez), r12 = 2.0 * (ex * ey - ez * ew), r13 = 2.0 * (ex * ez + ey * ew);
    const double r21 = 2.0 * (ex * ey + ez * ew), r22 = 1.0 - 2.0 * (ex * ex + ez * ez), r23 = 2.0 * (ey * ez - ex * ew);
    const double r31 = 2.0 * (ex * ez - ey * ew), r32 = 2.0 * (ey * ez + ex * ew), r33 = 1.0 - 2.0 * (ex * ex + ey * ey);
    for (int k = 0; k < STATES; k++) out[k] = s[k];
    out[13] = atan2(r32, r33);
    out[14] = asin(clamp(-r31, -1.0, 1.0));
    out[15] = atan2(r21, r11);
    for (int k = 0; k < 3; k++) out[16 + k] = h->current[k];
    out[19] = u - r11 * cn - r21 * ce - r31 * cd;
    out[20] = v - r12 * cn - r22 * ce - r32 * cd;
    out[21] = w - r13 * cn - r23 * ce - r33 * cd;
    double thrust[MOST_THRUSTERS] = {0.0}, push[6], a[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < (int)c->thrusters; i++) thrust[i] = h->gain[i] * h->motor[i];
    if (h->held == 0.0) {
        push_of(c, thrust, push);
        a[0] = change[7] + push[0] / mass_of(c, 0) + q * w - r * v;
        a[1] = change[8] + push[1] / mass_of(c, 1) + r * u - p * w;
        a[2] = change[9] + push[2] / mass_of(c, 2) + p * v - q * u;
    }
    out[22] = a[0] - h->gravity * r31;
    out[23] = a[1] - h->gravity * r32;
    out[24] = a[2] - h->gravity * r33;
    for (int i = 0; i < MOST_THRUSTERS; i++) out[25 + i] = thrust[i];
}
