/* Limits and bounds of the program of a step, and the thrust reference that holds the last plan (autopilot/control/bounds.py
 * says what the arrays mean). */
#include <math.h>

#include "common.h"

enum { CLEARANCE, DEPTH, PLANAR, HEAVE, YAW_RATE, KINDS };

typedef struct {
    long n, thrusters;
    double radius_m, planar_m_s, heave_m_s, yaw_rate_rad_s, depth_min_m, depth_max_m, depth_m, slowest_m_s;
    double largest_thrust_share, change;
    const double *back_off, *thrust_back_off, *limit_n;  /* (KINDS, n - 1), (n, thrusters), (thrusters) */
    const double *thrust_ref, *thrust, *weight;          /* (n, thrusters) each */
    double *limits, *left, *keep_m, *tube_m, *held, *held_weight; /* (n - 1, KINDS), (n, thrusters), (n - 1), (n + 1); (n, thrusters) each */
} Program;
LAYOUT(Program, n, thrusters, radius_m, planar_m_s, heave_m_s, yaw_rate_rad_s, depth_min_m, depth_max_m, depth_m, slowest_m_s,
       largest_thrust_share, change, back_off, thrust_back_off, limit_n, thrust_ref, thrust, weight, limits, left, keep_m,
       tube_m, held, held_weight)

EXPORT void program_bounds(const Program *a) {
    const long inner = a->n - 1;
    for (long k = 0; k < inner; k++) {
        const double *off = a->back_off + k;
        double *limit = a->limits + KINDS * k;
        limit[0] = at_least(a->planar_m_s - off[PLANAR * inner], a->slowest_m_s);
        limit[1] = at_least(a->heave_m_s - off[HEAVE * inner], 0.0);
        limit[2] = at_least(a->yaw_rate_rad_s - off[YAW_RATE * inner], 0.0);
        /* A vehicle outside its depth band is asked to come no farther out, not to be inside at once. */
        limit[3] = at_most(a->depth_m, a->depth_min_m + off[DEPTH * inner]);
        limit[4] = at_least(a->depth_m, a->depth_max_m - off[DEPTH * inner]);
        a->keep_m[k] = a->radius_m + off[CLEARANCE * inner];
        a->tube_m[k + 1] = off[CLEARANCE * inner];
    }
    a->tube_m[0] = a->tube_m[1];
    a->tube_m[a->n] = a->tube_m[inner];
    for (long k = 0; k < a->n; k++)
        for (long v = 0; v < a->thrusters; v++) {
            const long i = a->thrusters * k + v;
            const double limit = a->limit_n[v];
            const double left = limit - at_most(a->thrust_back_off[i], a->largest_thrust_share * limit);
            const double wanted = clamp(a->thrust_ref[i], -left, left);
            a->left[i] = left;
            a->held_weight[i] = a->weight[i] + a->change;
            a->held[i] = (a->weight[i] * wanted + a->change * a->thrust[i]) / a->held_weight[i];
        }
}

/* Smallest distance by which points (m, 2), `stride` doubles apart, meet their half-planes (m, slots); NaN if there is one. */
EXPORT double least_room(long m, long slots, const double *points, long stride, const double *normals, const double *offsets) {
    double least = INFINITY;
    for (long k = 0; k < m; k++)
        for (long i = k * slots; i < (k + 1) * slots; i++)
            least = at_most(normals[2 * i] * points[stride * k] + normals[2 * i + 1] * points[stride * k + 1] - offsets[i], least);
    return least;
}

/* Largest difference of `width` columns of two tables (m, columns); b may be NULL: of a from zero. */
EXPORT double largest_gap(long m, long columns, long first, long width, const double *a, const double *b) {
    double largest = 0.0;
    for (long k = 0; k < m; k++)
        for (long i = columns * k + first; i < columns * k + first + width; i++) {
            const double gap = fabs(a[i] - (b != NULL ? b[i] : 0.0));
            if (isnan(gap)) return gap;
            largest = gap > largest ? gap : largest;
        }
    return largest;
}
