/* What the prediction is compared with, node by node: the way along a route, and thrust that holds its velocities.
 * autopilot/control/path/reference.py says what the numbers mean. Forces come from the generated model. */
#include <math.h>
#include <string.h>

#include "common.h"
#include "model.c"

enum { NX = 8, AXES = 4, X = 0, Y, Z, YAW, U, V, W, R, MOVES = 3 };

typedef struct {
    double x, y;
} Place;

typedef struct {
    long thrusters, clipped; /* clipped: thrust beyond its limit is cut; else it is counted and shared by others */
    const double *coefficients, *inverse, *limit_n; /* of the model; (AXES, thrusters) force to thrust; (thrusters) */
} ReferenceStruct;
LAYOUT(ReferenceStruct, thrusters, clipped, coefficients, inverse, limit_n)

typedef struct {
    long nodes, legs, climb_at_once; /* depth changes as fast as heave allows, not so that it arrives with the route */
    double s0_m, depth_m, yaw_rad, cruise_m_s, speed_limit_m_s, heave_limit_m_s, yaw_rate_limit_rad_s;
    double corner_ahead_m, water_share, upstream_share, slow_current_share, fast_current_share, slowest_m_s;
    double heave_share, yaw_rate_share, least_depth_time_s, deceleration[MOVES];
    const double *t_s, *x0, *current, *s; /* (nodes), (NX), (3), (legs + 1) */
    const Place *corner, *tangent;        /* (legs + 1), (legs) */
    double *x, *thrust;                   /* (nodes, NX), (nodes - 1, thrusters) */
} RolloutArguments;
LAYOUT(RolloutArguments, nodes, legs, climb_at_once, s0_m, depth_m, yaw_rad, cruise_m_s, speed_limit_m_s, heave_limit_m_s, yaw_rate_limit_rad_s,
       corner_ahead_m, water_share, upstream_share, slow_current_share, fast_current_share, slowest_m_s, heave_share,
       yaw_rate_share, least_depth_time_s, deceleration, t_s, x0, current, s, corner, tangent, x, thrust)

/* Thrust (m, thrusters) that holds the velocities of states (m, NX). How many rows exceed limits without being cut. */
EXPORT long steady_thrust(const ReferenceStruct *a, long m, const double *x, double *thrust) {
    static const double nothing[AXES] = {0.0};
    long beyond = 0; /* NaN exceeds every limit */
    for (long k = 0; k < m; k++) {
        double state[NX] = {0.0}, slope[NX], *row = thrust + a->thrusters * k;
        memcpy(state + U, x + NX * k + U, AXES * sizeof(double));
        const double *arg[4] = {state, nothing, nothing, a->coefficients};
        double *res[2] = {slope, NULL};
        model_slope(arg, res, NULL, NULL, 0);
        int over = 0;
        for (long v = 0; v < a->thrusters; v++) {
            double sum = 0.0;
            for (int i = 0; i < AXES; i++) sum -= a->coefficients[i] * slope[U + i] * a->inverse[a->thrusters * i + v];
            over |= !(fabs(sum) <= a->limit_n[v]);
            row[v] = a->clipped ? clamp(sum, -a->limit_n[v], a->limit_n[v]) : sum;
        }
        beyond += over && !a->clipped;
    }
    return beyond;
}

/* Speed along a tangent that is asked for and that the limit on speed through the water allows: against a current a
 * larger share of that is used, as `water_speed_share` of way/reference.py. */
static double ground_speed(const RolloutArguments *a, Place tangent) {
    const double north = a->current[0], east = a->current[1], limit = a->speed_limit_m_s;
    const double along = tangent.x * north + tangent.y * east;
    const double span = a->fast_current_share - a->slow_current_share;
    const double fast = clamp((-along / at_least(limit, 1e-6) - a->slow_current_share) / span, 0.0, 1.0);
    const double water = (a->water_share + fast * (a->upstream_share - a->water_share)) * limit;
    const double room = along * along - (north * north + east * east) + water * water;
    const double reachable = room <= 0.0 ? 0.0 : along + sqrt(room);
    return at_least(at_most(a->cruise_m_s, reachable), a->slowest_m_s);
}

/* Arc length of the nearest point of a route within a window round a hint, and the distance to it (see Route.project). */
EXPORT double nearest_on_route(long legs, const Place *corner, const Place *tangent, const double *s, double x, double y,
                               double hint, double window, double *distance) {
    double best_s = 0.0, best = INFINITY;
    for (long i = 0; i < legs; i++) {
        const double low = at_least(hint - window - s[i], 0.0), high = at_most(hint + window - s[i], s[i + 1] - s[i]);
        if (i + 1 < legs && s[i + 1] < hint - window) continue;
        if (low > high) break;
        const double dx = x - corner[i].x, dy = y - corner[i].y;
        const double along = clamp(dx * tangent[i].x + dy * tangent[i].y, low, high);
        const double off = hypot(dx - along * tangent[i].x, dy - along * tangent[i].y);
        if (off < best) {
            best = off;
            best_s = s[i] + along;
        }
    }
    *distance = best;
    return best_s;
}

static long leg_at(const RolloutArguments *a, double s) {
    long leg = 0;
    while (leg < a->legs - 1 && s >= a->s[leg + 1]) leg++;
    return leg;
}

/* References (nodes, NX) and their thrust; returns as steady_thrust does. */
EXPORT long rollout(const RolloutArguments *a, const ReferenceStruct *steady) {
    const double length = a->s[a->legs], rest = at_least(length - a->s0_m, 0.0);
    const Place ahead = a->tangent[leg_at(a, a->s0_m + at_most(a->corner_ahead_m, 0.5 * rest))];
    const double speed = ground_speed(a, ahead), dz = a->depth_m - a->x0[Z], turn = a->yaw_rad - a->x0[YAW];
    const double with_route = at_least(fabs(dz) / at_least(rest / speed, a->least_depth_time_s), a->slowest_m_s);
    const double fastest = a->heave_share * a->heave_limit_m_s;
    const double climb = a->climb_at_once ? fastest : at_most(with_route, fastest);
    const double distance[MOVES] = {rest, fabs(dz), fabs(turn)};
    const double wanted[MOVES] = {speed, climb, a->yaw_rate_share * a->yaw_rate_limit_rad_s};
    const double down = copysign(1.0, dz), round = copysign(1.0, turn);
    /* Each of the three moves keeps its speed and stops after its distance: v = sqrt(2 a d) at the end. */
    double start[MOVES], brake_s[MOVES];
    for (int i = 0; i < MOVES; i++) {
        start[i] = at_most(wanted[i], sqrt(2.0 * a->deceleration[i] * distance[i]));
        brake_s[i] = start[i] != 0.0 ? distance[i] / start[i] - 0.5 * start[i] / a->deceleration[i] : 0.0;
    }
    long leg = leg_at(a, a->s0_m);
    for (long k = 0; k < a->nodes; k++) {
        double travel[MOVES], rate[MOVES], *x = a->x + NX * k;
        for (int i = 0; i < MOVES; i++) {
            const double until = brake_s[i] - a->t_s[k];
            rate[i] = clamp(until * a->deceleration[i] + start[i], 0.0, start[i]);
            travel[i] = distance[i] - rate[i] * rate[i] / (2.0 * a->deceleration[i]) - at_least(until, 0.0) * start[i];
        }
        const double s = a->s0_m + travel[0];
        while (leg < a->legs - 1 && s >= a->s[leg + 1]) leg++;
        while (leg > 0 && s < a->s[leg]) leg--;
        const Place from = a->corner[leg], tangent = a->tangent[leg];
        const double on = clamp(s, 0.0, length) - a->s[leg], yaw = a->x0[YAW] + round * travel[2];
        const double north = tangent.x * rate[0] - a->current[0], east = tangent.y * rate[0] - a->current[1];
        const double c = cos(yaw), sine = sin(yaw);
        x[X] = from.x + tangent.x * on;
        x[Y] = from.y + tangent.y * on;
        x[Z] = a->x0[Z] + down * travel[1];
        x[YAW] = yaw;
        x[U] = c * north + sine * east;
        x[V] = c * east - sine * north;
        x[W] = down * rate[1] - a->current[2];
        x[R] = round * rate[2];
    }
    return steady_thrust(steady, a->nodes - 1, a->x, a->thrust);
}
