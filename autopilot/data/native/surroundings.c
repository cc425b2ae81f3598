/* What a plan meets: half-planes of a fence with few features in the common case, margins of the tube.
 *
 * autopilot/control/constraints/chords.py does the half-planes in all other cases: paths in forbidden ground or through walls,
 * moving obstacles, fences with many features; tests/control/test_compiled_functions.py holds both against each other.
 * The tube: autopilot/control/robust/tube.py.
 */
#include <math.h>

#include "common.h"

typedef struct {
    double x, y;
} Place;

/* As control/constraints/obstacles.py lays it out. */
typedef struct {
    long edges, rounds;
    const Place *a, *ab, *along, *normal; /* per edge */
    const long *polygon;
    const Place *center; /* per round thing */
    const double *radius, *side;
    double tiny, far, recovery_m_s;
} Boundaries;
LAYOUT(Boundaries, edges, rounds, a, ab, along, normal, polygon, center, radius, side, tiny, far, recovery_m_s)

/* With more features chords.py, which leaves out far ones, is as fast. */
enum { MOST_EDGES = 128, MOST_ROUNDS = 160, MOST_SLOTS = 16 };

static inline Place minus(Place a, Place b) { return (Place){a.x - b.x, a.y - b.y}; }
static inline double dot(Place a, Place b) { return a.x * b.x + a.y * b.y; }

typedef struct {
    double at, distance;
    Place normal;
    int leaves;
} Met;

/* Round thing `r` as the chord from p meets it. */
static Met meet(const Boundaries *b, long r, Place p, Place step) {
    const Place ray = minus(p, b->center[r]);
    const double length2 = at_least(dot(step, step), b->tiny * b->tiny);
    Met met = {clamp(-dot(step, ray) / length2, 0.0, 1.0), 0.0, {1.0, 0.0}, 0};
    met.leaves = sqrt(dot(ray, ray)) < b->radius[r];
    if (b->side[r] < 0.0 || met.leaves) met.at = 1.0;
    const Place gap = {ray.x + met.at * step.x, ray.y + met.at * step.y};
    const double rho = sqrt(dot(gap, gap));
    if (rho >= b->tiny) met.normal = (Place){gap.x / rho, gap.y / rho};
    met.normal.x *= b->side[r];
    met.normal.y *= b->side[r];
    met.distance = (rho - b->radius[r]) * b->side[r];
    return met;
}

typedef struct {
    double distance[MOST_SLOTS], offset[MOST_SLOTS];
    Place normal[MOST_SLOTS];
    int used;
} Nearest;

static void offer(Nearest *kept, int slots, double distance, Place normal, double offset) {
    if (kept->used == slots && !(distance < kept->distance[slots - 1])) return;
    int i = kept->used < slots ? kept->used++ : slots - 1;
    for (; i > 0 && distance < kept->distance[i - 1]; i--) {
        kept->distance[i] = kept->distance[i - 1];
        kept->offset[i] = kept->offset[i - 1];
        kept->normal[i] = kept->normal[i - 1];
    }
    kept->distance[i] = distance;
    kept->offset[i] = offset;
    kept->normal[i] = normal;
}

/* Fills `normals` (m, slots) and `offsets` (m, slots) for m + 1 points, `stride` doubles apart, unless normals is NULL.
 * Returns the margin; NaN when the case is not a common one. */
EXPORT double half_planes(const Boundaries *b, long m, const double *points, long stride, const double *t_s,
                          const double *keep_m, long slots, Place *normals, double *offsets) {
    if (b->edges > MOST_EDGES || b->rounds > MOST_ROUNDS || slots > MOST_SLOTS || m < 1) return NAN;
    double lack_e[MOST_EDGES], lack_r[MOST_ROUNDS], before_rho[MOST_EDGES], margin = b->far - keep_m[0];
    int before_front[MOST_EDGES], lacks = 0;
    Met met[MOST_ROUNDS];
    Place before = {0.0, 0.0};
    for (long i = 0; i <= m; i++) {
        const Place p = {points[stride * i], points[stride * i + 1]};
        const Place step = minus(p, before);
        if (!isfinite(p.x + p.y)) return NAN;
        const double keep = keep_m[i > 0 ? i - 1 : 0], length = sqrt(dot(step, step));
        double rho[MOST_EDGES], line[MOST_EDGES], least = b->far;
        Nearest kept = {.used = 0};
        for (long e = 0; e < b->edges; e++) {
            const Place ray = minus(p, b->a[e]), along = b->along[e];
            const double share = ray.x * along.x - ray.y * along.y; /* real part of the product */
            const double on = clamp(share, 0.0, 1.0);
            const Place gap = {ray.x - on * b->ab[e].x, ray.y - on * b->ab[e].y};
            rho[e] = sqrt(dot(gap, gap));
            line[e] = dot(ray, b->normal[e]);
            const int front = line[e] > -b->tiny;
            if (i > 0 && front != before_front[e] && before_rho[e] <= length) return NAN; /* through a wall, maybe */
            before_front[e] = front;
            before_rho[e] = rho[e];
            const double distance = share >= 1.0 ? b->far : rho[e];
            least = at_most(distance, least);
            if (i == 0) {
                lack_e[e] = keep_m[0] - distance;
                lacks |= lack_e[e] > 0.0;
            } else if (normals != NULL && share > 0.0 && distance < b->far) {
                const Place normal = rho[e] < b->tiny ? b->normal[e] : (Place){gap.x / rho[e], gap.y / rho[e]};
                double offset = dot(normal, minus(p, gap));
                if (lacks) offset -= at_least(lack_e[e] - b->recovery_m_s * t_s[i], 0.0);
                offer(&kept, (int)slots, distance, normal, offset + keep);
            }
        }
        for (long first = 0, end; first < b->edges; first = end) {
            double nearest = rho[first];
            for (end = first + 1; end < b->edges && b->polygon[end] == b->polygon[first]; end++)
                nearest = at_most(rho[end], nearest);
            for (long e = first; e < end; e++)
                if (rho[e] <= nearest && line[e] < 0.0) return NAN; /* forbidden ground, maybe */
        }
        for (long r = 0; r < b->rounds; r++) {
            if (i == 0) {
                const Place ray = minus(p, b->center[r]);
                const double distance = (sqrt(dot(ray, ray)) - b->radius[r]) * b->side[r];
                lack_r[r] = keep_m[0] - distance;
                lacks |= lack_r[r] > 0.0;
                least = at_most(distance, least);
                continue;
            }
            if (i == 1) met[r] = meet(b, r, before, step);
            const Met own = met[r];
            least = at_most(own.distance, least);
            Met next = own;
            int again = 0;
            if (i < m) {
                const Place to = {points[stride * (i + 1)], points[stride * (i + 1) + 1]};
                next = met[r] = meet(b, r, p, minus(to, p));
                again = !((next.at == 0.0 && own.at == 1.0) || next.leaves) && b->side[r] > 0.0;
            }
            if (normals == NULL) continue;
            for (int k = 0; k <= again; k++) {
                const Met *each = k ? &next : &own;
                double offset = dot(each->normal, b->center[r]) + b->radius[r] * b->side[r];
                if (lacks) offset -= at_least(lack_r[r] - b->recovery_m_s * t_s[i], 0.0);
                offer(&kept, (int)slots, each->distance, each->normal, offset + keep);
            }
        }
        margin = at_most(least - keep, margin);
        before = p;
        if (i == 0 || normals == NULL) continue;
        for (int k = 0; k < slots; k++) {
            const int used = k < kept.used && kept.distance[k] < b->far;
            normals[slots * (i - 1) + k] = used ? kept.normal[k] : (Place){0.0, 0.0};
            offsets[slots * (i - 1) + k] = used ? kept.offset[k] : -1.0;
        }
    }
    return margin;
}

/* As autopilot/control/robust/tube.py: what the numbers of `Tube.given` mean. */
enum { CLEARANCE, DEPTH, PLANAR, HEAVE, YAW_RATE, KINDS };
enum { MIX = 0, ADDED = 3, LEAST = ADDED + KINDS, MOST = LEAST + KINDS, SIGMAS = MOST + KINDS, FIRST = SIGMAS + KINDS, STEP, BAND, SHARE, SPEED };
enum { GROUPS = 3, STATES_OUT = 10, STATE = 8, SURGE = 4 };

static double largest(const double *v) {
    const double half = 0.5 * (v[0] - v[2]);
    return 0.5 * (v[0] + v[2]) + sqrt(half * half + v[1] * v[1]);
}

/* Back-offs of the states at nodes 1 .. n-1 (KINDS, n - 1), of the thrusters at nodes 0 .. n-1 (n, thrusters). */
EXPORT void tube_back_offs(const double *table, long speeds, long n, long thrusters, const double *given,
                           const double *x, double *states, double *thrust) {
    const long width = STATES_OUT + thrusters;
    for (long k = 0; k < n; k++) {
        const double place =
            clamp((x[STATE * k + SURGE] - given[FIRST]) / given[STEP], 0.0, (double)(speeds - 1));
        const long low = row_below(place, speeds);
        const double share = place - (double)low;
        const double *a = table + ((low * (n + 1)) + k) * width * GROUPS, *b = a + (n + 1) * width * GROUPS;
        double row[STATES_OUT];
        for (long i = k > 0 ? 0 : STATES_OUT; i < width; i++) {
            double below = 0.0, above = 0.0;
            for (int g = 0; g < GROUPS; g++) {
                below += a[GROUPS * i + g] * given[MIX + g];
                above += b[GROUPS * i + g] * given[MIX + g];
            }
            const double value = below + share * (above - below);
            if (i < STATES_OUT)
                row[i] = value;
            else
                thrust[thrusters * k + i - STATES_OUT] = given[BAND] * sqrt(value);
        }
        if (k == 0) continue;
        const double variance[KINDS] = {largest(row), row[3], largest(row + 5), row[8], row[9]};
        for (int kind = 0; kind < KINDS; kind++) {
            const double wanted = given[SIGMAS + kind] * sqrt(variance[kind] + given[ADDED + kind]);
            states[(n - 1) * kind + k - 1] = at_least(at_most(wanted, given[MOST + kind]), given[LEAST + kind]);
        }
        double *planar = states + (n - 1) * PLANAR + k - 1; /* evidence leaves a share of it, beyond the fixed margin */
        *planar = at_least(given[SHARE] * *planar, at_most(*planar, given[SPEED]));
    }
}
