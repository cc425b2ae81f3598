/* Following a plan: where the acting thrust takes the vehicle, thrust between two steps, places on a trajectory. See
 * autopilot/control/nmpc/lag.py, control/robust/inner.py and control/energy/track.py. */
#include <math.h>
#include <string.h>

#include "common.h"
#include "model.c"

enum { NX = 8, AXES = 4, X = 0, Y, Z, YAW, U, V, W, R };

typedef struct {
    long thrusters, steps;
    double dt_s;                                          /* in so many Runge-Kutta steps */
    const double *coefficients, *allocation;              /* of the model: (13), (AXES, thrusters) */
    const double *x, *thrust, *current;                   /* (NX), (thrusters), (3) */
    double *after;                                        /* (NX) */
} Ahead;
LAYOUT(Ahead, thrusters, steps, dt_s, coefficients, allocation, x, thrust, current, after)

/* State after dt_s with constant thrust. */
EXPORT void state_ahead(const Ahead *a) {
    static const double share[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    double force[AXES] = {0.0}, x[NX];
    for (int i = 0; i < AXES; i++)
        for (long v = 0; v < a->thrusters; v++) force[i] += a->allocation[a->thrusters * i + v] * a->thrust[v];
    const double h = a->dt_s / (double)a->steps;
    memcpy(x, a->x, sizeof x);
    for (long step = 0; step < a->steps; step++) {
        double slope[NX] = {0.0}, sum[NX] = {0.0}, state[NX];
        for (int stage = 0; stage < 4; stage++) {
            for (int i = 0; i < NX; i++) state[i] = x[i] + share[stage] * h * slope[i];
            const double *arg[4] = {state, force, a->current, a->coefficients};
            double *res[2] = {slope, NULL};
            model_slope(arg, res, NULL, NULL, 0);
            for (int i = 0; i < NX; i++) sum[i] += weight[stage] * slope[i];
        }
        for (int i = 0; i < NX; i++) x[i] += h / 6.0 * sum[i];
    }
    memcpy(a->after, x, sizeof x);
}

typedef struct {
    long n, thrusters, surges;
    double first_m_s, step_m_s;                /* surge speeds of the gains */
    const double *t_s, *gains;                 /* (n + 1), (surges, thrusters, NX) */
    const double *plan, *plan_thrust;          /* (n + 1, NX), (n, thrusters) */
    const double *x, *current, *planned_current, *limit_n; /* (NX), (3), (3), (thrusters) */
    double *thrust;                            /* (thrusters) */
} Inner;
LAYOUT(Inner, n, thrusters, surges, first_m_s, step_m_s, t_s, gains, plan, plan_thrust, x, current, planned_current,
       limit_n, thrust)

/* Thrust after_s into the plan: of the plan, and the feedback of the error, velocities over ground. */
EXPORT void inner_thrust(const Inner *a, double after_s) {
    const double time = clamp(after_s, 0.0, a->t_s[a->n]);
    long k = 0;
    while (time > a->t_s[k + 1]) k++;
    const double share = (time - a->t_s[k]) / (a->t_s[k + 1] - a->t_s[k]);
    const double *from = a->plan + NX * k, *to = from + NX;
    double z[NX], e[NX];
    for (int i = 0; i < NX; i++) {
        z[i] = from[i] + share * (to[i] - from[i]);
        e[i] = a->x[i] - z[i];
    }
    const double c = cos(z[YAW]), s = sin(z[YAW]), north = e[X], east = e[Y], turn = 2.0 * 3.14159265358979323846;
    e[X] = c * north + s * east;
    e[Y] = c * east - s * north;
    e[YAW] -= turn * rint(e[YAW] / turn);
    const double n = a->current[0] - a->planned_current[0], o = a->current[1] - a->planned_current[1];
    const double cx = cos(a->x[YAW]), sx = sin(a->x[YAW]);
    e[U] += cx * n + sx * o;
    e[V] += cx * o - sx * n;
    e[W] += a->current[2] - a->planned_current[2];
    const double surge = k < 2 ? a->plan[U] : z[U], most = (double)(a->surges - 1);
    const double place = clamp((surge - a->first_m_s) / a->step_m_s, 0.0, most);
    const long low = row_below(place, a->surges);
    const double *below = a->gains + low * a->thrusters * NX, *above = below + a->thrusters * NX;
    for (long v = 0; v < a->thrusters; v++) {
        double sum = a->plan_thrust[a->thrusters * k + v];
        for (int i = 0; i < NX; i++) {
            const double lower = below[NX * v + i], upper = above[NX * v + i];
            sum += (lower + (place - (double)low) * (upper - lower)) * e[i];
        }
        a->thrust[v] = clamp(sum, -a->limit_n[v], a->limit_n[v]);
    }
}

/* The first `used` columns of rows (count, width) at times t (count), linear in between, ends held: out (m, used) at times
 * `at` (m); NaN at NaN. */
static void columns_at(long count, long width, long used, const double *t, const double *rows, long m, const double *at,
                       double *out) {
    long j = 0;
    for (long k = 0; k < m; k++, out += used) {
        if (isnan(at[k])) {
            for (long i = 0; i < used; i++) out[i] = at[k];
            continue;
        }
        if (!(at[k] > t[0]) || at[k] >= t[count - 1]) {
            memcpy(out, rows + (at[k] >= t[count - 1] ? width * (count - 1) : 0), (size_t)used * sizeof *out);
            continue;
        }
        while (j > 0 && at[k] < t[j]) j--;
        while (j < count - 2 && at[k] >= t[j + 1]) j++;
        const double *from = rows + width * j, share = (at[k] - t[j]) / (t[j + 1] - t[j]);
        for (long i = 0; i < used; i++) out[i] = from[i] + share * (from[width + i] - from[i]);
    }
}

/* The same of all columns. */
EXPORT void rows_at(long count, long width, const double *t, const double *rows, long m, const double *at, double *out) {
    columns_at(count, width, width, t, rows, m, at, out);
}

/* Of `points` times from first_s on, step_s apart, the one at which the rows (as rows_at) are nearest to x (NX), its
 * heading counted by `lever_m`; its distance in the plane. The first, infinitely far, where none has a finite distance. */
EXPORT double nearest_at(long count, long width, const double *t, const double *rows, const double *x, double first_s,
                         double step_s, long points, double lever_m, double *away_m) {
    double best = INFINITY, best_s = first_s, row[YAW + 1], offset = 0.0;
    const double turn = 2.0 * 3.14159265358979323846;
    *away_m = INFINITY;
    for (long k = 0; k < points; k++) {
        const double at = first_s + step_s * (double)k;
        columns_at(count, width, YAW + 1, t, rows, 1, &at, row);
        if (k == 0) offset = turn * rint((row[YAW] - x[YAW]) / turn);
        const double dx = row[X] - x[X], dy = row[Y] - x[Y], yaw = lever_m * (row[YAW] - x[YAW] - offset);
        const double gap = dx * dx + dy * dy;
        if (gap + yaw * yaw < best) {
            best = gap + yaw * yaw;
            best_s = at;
            *away_m = sqrt(gap);
        }
    }
    return best_s;
}
