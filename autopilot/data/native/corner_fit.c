/* Pose of the camera from the corners of markers, and where their sheets lie: Gauss-Newton over position, rotation, blur
 * and the sheets' offsets.
 *
 * The same numbers as estimator/pnp.py and estimator/sheet_fit.py, which say what they mean and stand in where there is
 * no library, and for other lenses than Brown's. tests/estimator/test_compiled_fit.py holds them against each other.
 * A marker's eight pixel coordinates depend on pose and blur and on the offsets of its own sheet only: that is what
 * makes the sums short.
 */
#include <math.h>
#include <string.h>

#include "common.h"

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3") /* unrolls the many short loops: half of the time */
#endif

enum { POSE = 7, BLUR = 6, OFFSETS = 4, OWN = POSE + OFFSETS, WIDTH = OWN + 1, CORNERS = 4, PIXELS = 2 * CORNERS };

typedef struct {
    double focal[2], center[2], distortion[5]; /* k1 k2 p1 p2 k3 */
    double mounting[9], position[3];           /* body from camera; its place in the body */
    double near_m, focal_water;
} LensStruct;
LAYOUT(LensStruct, focal, center, distortion, mounting, position, near_m, focal_water)

typedef struct {
    long steps;
    double converged, shrink_information, min_scale, prior_count, corner_floor, corner_ratio, print_count, least_print;
} FitLimits;
LAYOUT(FitLimits, steps, converged, shrink_information, min_scale, prior_count, corner_floor, corner_ratio, print_count,
       least_print)

/* One fit, all of it in one array: what is given, what is found, and work space, in the order of compiled_fit.py. */
typedef struct {
    long markers, sheets;                      /* m, s; no sheets: the map is exact. d = 7 + 4 s unknowns */
    const long *sheet;                         /* (m), -1 = none */
    double *pos, *rotation, *up;               /* (3), (3, 3), (3): changed, but for up */
    double *tilt, *shrink_prior, *shrink, *offset_floor; /* numbers; the blur is changed */
    double *corners, *pixels, *expected;       /* (m, 4, 3), (m, 4, 2), (m, 4, 2) */
    double *pivot, *print_sigma;               /* (s, 3), (m) */
    double *prior_offset, *prior;              /* (4 s), (4 s, 4 s) covariance */
    double *offset;                            /* (4 s), and so on: found */
    double *rows;                              /* (8 m, 12) derivatives by pose, blur and own sheet, and the residual */
    double *information;                       /* (d, d) without the offsets' prior */
    double *left, *keep;                       /* (8 m) */
    double *z, *noise, *tilt_variance;         /* (4), (4, 4), one: of sheets, what the corners say of the pose given */
    double *by_offsets, *alone, *toward, *strain; /* the offsets: (4, 4 s), (4 s, 4 s), (4 s), (s) */
    double *inward, *weight;                   /* (8 m), and so on: work space */
    double *off, *sorted, *depth;              /* (4 m), (4 m), (m) */
    double *delta, *full, *factor, *known;     /* (d), (d, d) with all priors, its root, (4 s, 4 s) the prior's inverse */
} Fit;

static Fit fit_of(long m, long s, const long *sheet, double *at) {
    const long n = PIXELS * m, d = POSE + OFFSETS * s, size = OFFSETS * s;
    Fit t = {m, s, sheet};
    struct {
        double **place;
        long count;
    } parts[] = {
        {&t.pos, 3}, {&t.rotation, 9}, {&t.up, 3}, {&t.tilt, 1}, {&t.shrink_prior, 1}, {&t.shrink, 1},
        {&t.offset_floor, 1}, {&t.corners, 12 * m}, {&t.pixels, n}, {&t.expected, n}, {&t.pivot, 3 * s},
        {&t.print_sigma, m}, {&t.prior_offset, size}, {&t.prior, size * size}, {&t.offset, size},
        {&t.rows, WIDTH * n}, {&t.information, d * d}, {&t.left, n}, {&t.keep, n}, {&t.z, 4}, {&t.noise, 16},
        {&t.tilt_variance, 1}, {&t.by_offsets, 4 * size}, {&t.alone, size * size}, {&t.toward, size}, {&t.strain, s},
        {&t.inward, n}, {&t.weight, n}, {&t.off, n / 2}, {&t.sorted, n / 2}, {&t.depth, m}, {&t.delta, d},
        {&t.full, d * d}, {&t.factor, d * d}, {&t.known, size * size},
    };
    for (size_t i = 0; i < sizeof parts / sizeof parts[0]; i++) {
        *parts[i].place = at;
        at += parts[i].count;
    }
    return t;
}

/* Brown's distortion of an image point, and its derivatives xx, yy, xy. */
static void bend(const double *k, double x, double y, double bent[2], double slope[3]) {
    const double k1 = k[0], k2 = k[1], p1 = k[2], p2 = k[3], k3 = k[4];
    const double r2 = x * x + y * y, radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    const double growth = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)), xy = 2.0 * x * y;
    bent[0] = x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x);
    bent[1] = y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy;
    slope[0] = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
    slope[1] = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
    slope[2] = growth * x * y + 2.0 * (p1 * x + p2 * y);
}

/* Image points (n, 2) of pixels (n, 2): the way back through the lens by Newton's method. */
EXPORT void unbend(const LensStruct *lens, long n, long steps, const double *pixels, double *ideal) {
    for (long i = 0; i < n; i++) {
        const double target_x = (pixels[2 * i] - lens->center[0]) / lens->focal[0];
        const double target_y = (pixels[2 * i + 1] - lens->center[1]) / lens->focal[1];
        double x = target_x, y = target_y, bent[2], slope[3];
        for (long step = 0; step < steps; step++) {
            bend(lens->distortion, x, y, bent, slope);
            const double off_x = bent[0] - target_x, off_y = bent[1] - target_y;
            const double determinant = slope[0] * slope[1] - slope[2] * slope[2];
            x -= (slope[1] * off_x - slope[2] * off_y) / determinant;
            y -= (slope[0] * off_y - slope[2] * off_x) / determinant;
        }
        ideal[2 * i] = x;
        ideal[2 * i + 1] = y;
    }
}

/* Residuals, derivatives, and the depths of the markers' first corners; 0 if a corner is too near. */
static int linearise(const LensStruct *lens, const Fit *t) {
    double cam_from_ned[3][3], lever[3];
    for (int i = 0; i < 3; i++) {
        lever[i] = 0.0;
        for (int k = 0; k < 3; k++) lever[i] += lens->mounting[3 * k + i] * lens->position[k];
        for (int j = 0; j < 3; j++) {
            cam_from_ned[i][j] = 0.0;
            for (int k = 0; k < 3; k++) cam_from_ned[i][j] += t->rotation[3 * j + k] * lens->mounting[3 * k + i];
        }
    }
    for (long m = 0; m < t->markers; m++) {
        const long sheet = t->sheets ? t->sheet[m] : -1;
        const double *move = sheet < 0 ? NULL : t->offset + OFFSETS * sheet;
        const double c = move ? cos(move[3]) : 1.0, s = move ? sin(move[3]) : 0.0;
        for (int corner = 0; corner < CORNERS; corner++) {
            const long row = CORNERS * m + corner;
            const double *at = t->corners + 3 * row;
            double point[3] = {at[0], at[1], at[2]}, turned[2] = {0.0, 0.0}, arm[3], cam[3];
            if (move) {
                const double north = at[0] - t->pivot[3 * sheet], east = at[1] - t->pivot[3 * sheet + 1];
                turned[0] = c * north - s * east;
                turned[1] = s * north + c * east;
                point[0] += move[0] + (turned[0] - north);
                point[1] += move[1] + (turned[1] - east);
                point[2] += move[2];
            }
            if (corner == 0) t->depth[m] = point[2];
            for (int i = 0; i < 3; i++) arm[i] = point[i] - t->pos[i];
            for (int i = 0; i < 3; i++)
                cam[i] = arm[0] * cam_from_ned[i][0] + arm[1] * cam_from_ned[i][1] + arm[2] * cam_from_ned[i][2] - lever[i];
            if (!(cam[2] > lens->near_m)) return 0;
            const double x = cam[0] / cam[2], y = cam[1] / cam[2];
            double bent[2], slope[3];
            bend(lens->distortion, x, y, bent, slope);
            for (int axis = 0; axis < 2; axis++) {
                const double f = lens->focal[axis];
                const double by_x = f * slope[axis ? 2 : 0] / cam[2], by_y = f * slope[axis ? 1 : 2] / cam[2];
                const double by_z = -(by_x * x + by_y * y);
                double g[3], *jac = t->rows + WIDTH * (2 * row + axis);
                const double inward = t->inward[2 * row + axis];
                for (int i = 0; i < 3; i++)
                    g[i] = by_x * cam_from_ned[0][i] + by_y * cam_from_ned[1][i] + by_z * cam_from_ned[2][i];
                for (int i = 0; i < 3; i++) jac[i] = -g[i];
                jac[3] = g[1] * arm[2] - g[2] * arm[1];
                jac[4] = g[2] * arm[0] - g[0] * arm[2];
                jac[5] = g[0] * arm[1] - g[1] * arm[0];
                jac[BLUR] = inward;
                for (int i = 0; i < 3; i++) jac[POSE + i] = move ? g[i] : 0.0;
                jac[POSE + 3] = move ? g[1] * turned[0] - g[0] * turned[1] : 0.0;
                jac[OWN] = t->pixels[2 * row + axis] - (f * bent[axis] + lens->center[axis]) - *t->shrink * inward;
                t->left[2 * row + axis] = jac[OWN];
            }
        }
    }
    return 1;
}

/* Ratios of measured to expected standard deviation of corners, and of the variances of markers on their sheets. */
static void scatter(const FitLimits *limits, const Fit *t, const double *print_px, double ratios[2]) {
    double within = 0.0, shared2 = 0.0, stated2 = 0.0;
    long whole = 0;
    for (long m = 0; m < t->markers; m++) {
        const double *left = t->left + PIXELS * m, *keep = t->keep + PIXELS * m, *expected = t->expected + PIXELS * m;
        int all = 1;
        for (int i = 0; i < PIXELS; i++) all = all && keep[i] > 0.0;
        if (!all) continue;
        whole++;
        for (int axis = 0; axis < 2; axis++) {
            double mean = 0.0;
            for (int i = 0; i < CORNERS; i++) mean += left[2 * i + axis] / expected[2 * i + axis];
            mean /= CORNERS;
            shared2 += mean * mean;
            for (int i = 0; i < CORNERS; i++) {
                const double off = left[2 * i + axis] / expected[2 * i + axis] - mean;
                within += off * off;
            }
        }
        const double print = print_px[m] / expected[0];
        stated2 += print * print;
    }
    const double least2 = limits->min_scale * limits->min_scale, count = limits->prior_count;
    const double corner2 = at_least((within + count) / (6.0 * (double)whole + count), least2);
    const double freedom = 2.0 * (double)whole - (double)(POSE + OFFSETS * t->sheets);
    ratios[0] = sqrt(corner2);
    ratios[1] = 1.0;
    if (freedom <= 0.0) return;
    const double excess = shared2 - 0.25 * corner2 * freedom, stated = at_least(stated2 / (double)whole, limits->least_print);
    ratios[1] = at_least((limits->print_count + excess / stated) / (limits->print_count + freedom), 0.0);
}

/* Inverse variances of the pixel coordinates that are kept, 0 of the others. */
static void weigh(const LensStruct *lens, const FitLimits *limits, const Fit *t) {
    if (!t->sheets) {
        for (long i = 0; i < PIXELS * t->markers; i++) t->weight[i] = t->keep[i] / (t->expected[i] * t->expected[i]);
        return;
    }
    double ratios[2], *print_px = t->off;
    for (long m = 0; m < t->markers; m++)
        print_px[m] = t->print_sigma[m] * lens->focal_water / at_least(t->depth[m] - t->pos[2], 0.05);
    scatter(limits, t, print_px, ratios);
    for (long m = 0; m < t->markers; m++) {
        const double corner = ratios[0] * t->expected[PIXELS * m];
        const double weight = 1.0 / (corner * corner + 4.0 * ratios[1] * print_px[m] * print_px[m]);
        for (int i = 0; i < PIXELS; i++) t->weight[PIXELS * m + i] = weight * t->keep[PIXELS * m + i];
    }
}

/* Unknowns that the columns of a marker's rows belong to; how many there are. */
static int columns_of(const Fit *t, long marker, long columns[OWN]) {
    const long sheet = t->sheets ? t->sheet[marker] : -1;
    for (int i = 0; i < OWN; i++) columns[i] = i < POSE ? i : i + OFFSETS * sheet;
    return sheet < 0 ? POSE : OWN;
}

/* J' W of the residuals (8 m). */
static void gradient_of(const Fit *t, const double *residual, double *gradient) {
    long columns[OWN];
    memset(gradient, 0, sizeof(double) * (size_t)(POSE + OFFSETS * t->sheets));
    for (long m = 0; m < t->markers; m++) {
        const int own = columns_of(t, m, columns);
        double sum[WIDTH] = {0.0};
        for (long i = PIXELS * m; i < PIXELS * (m + 1); i++) {
            const double by = t->weight[i] * residual[i], *row = t->rows + WIDTH * i;
            for (int a = 0; a < WIDTH; a++) sum[a] += row[a] * by;
        }
        for (int a = 0; a < own; a++) gradient[columns[a]] += sum[a];
    }
}

/* J' W J, the lower triangle, and J' W r. */
static void sums(const Fit *t, double *gradient) {
    const long d = POSE + OFFSETS * t->sheets;
    long columns[OWN];
    memset(t->information, 0, sizeof(double) * (size_t)(d * d));
    memset(gradient, 0, sizeof(double) * (size_t)d);
    for (long m = 0; m < t->markers; m++) {
        const int own = columns_of(t, m, columns);
        double block[OWN][WIDTH] = {{0.0}};
        for (long i = PIXELS * m; i < PIXELS * (m + 1); i++) {
            const double *row = t->rows + WIDTH * i, weight = t->weight[i];
            for (int a = 0; a < OWN; a++) {
                const double weighted = row[a] * weight;
                for (int b = 0; b < WIDTH; b++) block[a][b] += weighted * row[b];
            }
        }
        for (int a = 0; a < own; a++) {
            gradient[columns[a]] += block[a][OWN];
            for (int b = 0; b <= a; b++) t->information[d * columns[a] + columns[b]] += block[a][b];
        }
    }
}

static void add_priors(const FitLimits *limits, const Fit *t, double *information, double *gradient) {
    const long d = POSE + OFFSETS * t->sheets;
    double lean[2];
    for (int i = 0; i < 2; i++)
        lean[i] = t->rotation[3 * i] * t->up[0] + t->rotation[3 * i + 1] * t->up[1] + t->rotation[3 * i + 2] * t->up[2];
    if (information) {
        information[d * 3 + 3] += *t->tilt;
        information[d * 4 + 4] += *t->tilt;
        information[d * BLUR + BLUR] += limits->shrink_information;
    }
    gradient[3] += *t->tilt * lean[1];
    gradient[4] -= *t->tilt * lean[0];
    gradient[BLUR] += limits->shrink_information * (*t->shrink_prior - *t->shrink);
}

/* Information of everything with all priors, and the gradient. */
static void normal_equations(const FitLimits *limits, const Fit *t) {
    const long d = POSE + OFFSETS * t->sheets, s = d - POSE;
    double *gradient = t->delta;
    sums(t, gradient);
    if (!t->sheets) {
        double squares = limits->prior_count, count = 0.0;
        for (long i = 0; i < PIXELS * t->markers; i++) {
            const double off = t->left[i] / t->expected[i];
            squares += t->keep[i] > 0.0 ? off * off : 0.0;
            count += t->keep[i];
        }
        const double scale = at_least(sqrt(squares / at_least(count - POSE + limits->prior_count, 1.0)), limits->min_scale);
        for (long i = 0; i < d; i++) gradient[i] /= scale * scale;
        for (long i = 0; i < d * d; i++) t->full[i] = t->information[i] / (scale * scale);
        add_priors(limits, t, t->full, gradient);
    } else {
        add_priors(limits, t, t->information, gradient);
        memcpy(t->full, t->information, sizeof(double) * (size_t)(d * d));
    }
    for (long i = 0; i < s; i++)
        for (long j = 0; j < s; j++) {
            if (j <= i) t->full[d * (POSE + i) + POSE + j] += t->known[s * i + j];
            gradient[POSE + i] += t->known[s * i + j] * (t->prior_offset[j] - t->offset[j]);
        }
    for (long i = 0; i < d; i++)
        for (long j = 0; j < i; j++) t->information[d * j + i] = t->information[d * i + j];
}

/* L with L L' = A from the lower triangle of A; 0 if it is not positive definite. */
static int root_of(long n, const double *a, double *root) {
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            double sum = a[n * i + j];
            for (long k = 0; k < j; k++) sum -= root[n * i + k] * root[n * j + k];
            if (j < i)
                root[n * i + j] = sum / root[n * j + j];
            else if (sum > 0.0)
                root[n * i + i] = sqrt(sum);
            else
                return 0;
        }
    return 1;
}

/* The solution of L L' x = b in place of b. */
static void solve(long n, const double *root, double *b) {
    for (long i = 0; i < n; i++) {
        for (long k = 0; k < i; k++) b[i] -= root[n * i + k] * b[k];
        b[i] /= root[n * i + i];
    }
    for (long i = n - 1; i >= 0; i--) {
        b[i] /= root[n * i + i];
        for (long k = 0; k < i; k++) b[k] -= root[n * i + k] * b[i];
    }
}

static int invert(long n, const double *a, double *root, double *inverse) {
    if (!root_of(n, a, root)) return 0;
    for (long i = 0; i < n; i++) { /* symmetric: rows are columns */
        for (long j = 0; j < n; j++) inverse[n * i + j] = i == j;
        solve(n, root, inverse + n * i);
    }
    return 1;
}

static double median_of(long n, double *values) {
    for (long gap = n / 2; gap > 0; gap /= 2) /* Shell's sort */
        for (long i = gap; i < n; i++) {
            const double value = values[i];
            long place = i;
            for (; place >= gap && values[place - gap] > value; place -= gap) values[place] = values[place - gap];
            values[place] = value;
        }
    return 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

/* Which corners fit to the others; whether these are those that did before. `off`, `sorted`: (4 m) each. */
static int same_fit(const FitLimits *limits, const Fit *t, double *off, double *sorted) {
    const long n = CORNERS * t->markers;
    for (long i = 0; i < n; i++) {
        const double x = t->left[2 * i] / t->expected[2 * i], y = t->left[2 * i + 1] / t->expected[2 * i + 1];
        off[i] = sorted[i] = sqrt(x * x + y * y);
    }
    const double most = at_least(limits->corner_ratio * median_of(n, sorted), limits->corner_floor);
    long fit = 0;
    for (long i = 0; i < n; i++) fit += off[i] <= most;
    const int all = 4 * fit < 3 * n;
    int same = 1;
    for (long i = 0; i < n; i++) {
        off[i] = all || off[i] <= most ? 1.0 : 0.0;
        same = same && off[i] == t->keep[2 * i];
    }
    return same;
}

static void move(const Fit *t, const double *delta) {
    const double a = delta[3], b = delta[4], c = delta[5], angle = sqrt(a * a + b * b + c * c);
    for (int i = 0; i < 3; i++) t->pos[i] += delta[i];
    *t->shrink += delta[BLUR];
    for (long i = 0; i < OFFSETS * t->sheets; i++) t->offset[i] += delta[POSE + i];
    if (angle < 1e-12) return;
    const double x = a / angle, y = b / angle, z = c / angle, s = sin(angle), v = 1.0 - cos(angle);
    const double turn[3][3] = {
        {1.0 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y},
        {v * x * y + s * z, 1.0 - v * (x * x + z * z), v * y * z - s * x},
        {v * x * z - s * y, v * y * z + s * x, 1.0 - v * (x * x + y * y)},
    };
    double before[9];
    memcpy(before, t->rotation, sizeof before);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            t->rotation[3 * i + j] = turn[i][0] * before[j] + turn[i][1] * before[3 + j] + turn[i][2] * before[6 + j];
}

/* Pose given the offsets, and the offsets alone: two independent pieces. Tilt and blur are marginalised, and how
 * unsure the tilt is follows with the offsets' prior. 0 if the corners do not determine the pose. */
static int pieces(const FitLimits *limits, const Fit *t) {
    static const long nuisance[3] = {3, 4, BLUR}, kept[4] = {0, 1, 2, 5};
    const long d = POSE + OFFSETS * t->sheets, s = d - POSE;
    double *g = t->delta, *a = t->full, own[16], root[16];
    *t->tilt_variance = 0.0;
    for (int k = 3; k < 5; k++) {
        for (long i = 0; i < d; i++) g[i] = i == k;
        solve(d, t->factor, g);
        *t->tilt_variance = at_least(g[k], *t->tilt_variance);
    }
    gradient_of(t, t->left, g);
    add_priors(limits, t, NULL, g);
    memcpy(a, t->information, sizeof(double) * (size_t)(d * d));
    for (int n = 0; n < 3; n++) {
        const double *pivot = a + d * nuisance[n], by = pivot[nuisance[n]], toward = g[nuisance[n]];
        for (long i = 0; i < d; i++) {
            if (i == nuisance[n]) continue;
            const double share = a[d * i + nuisance[n]] / by;
            g[i] -= share * toward;
            for (long j = 0; j < d; j++) a[d * i + j] -= share * pivot[j];
        }
    }
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) own[4 * i + j] = a[d * kept[i] + kept[j]];
    if (!invert(4, own, root, t->noise)) return 0;
    for (int i = 0; i < 4; i++) {
        t->z[i] = 0.0;
        for (int k = 0; k < 4; k++) t->z[i] += t->noise[4 * i + k] * g[kept[k]];
        for (long j = 0; j < s; j++) {
            double sum = 0.0;
            for (int k = 0; k < 4; k++) sum += t->noise[4 * i + k] * a[d * kept[k] + POSE + j];
            t->by_offsets[s * i + j] = sum;
        }
    }
    for (long i = 0; i < s; i++) {
        t->toward[i] = g[POSE + i];
        for (int k = 0; k < 4; k++) t->toward[i] -= t->by_offsets[s * k + i] * g[kept[k]];
        for (long j = 0; j < s; j++) {
            double sum = a[d * (POSE + i) + POSE + j];
            for (int k = 0; k < 4; k++) sum -= a[d * (POSE + i) + kept[k]] * t->by_offsets[s * k + j];
            t->alone[s * i + j] = sum;
        }
    }
    for (long k = 0; k < t->sheets; k++) {
        double off[4], held[4];
        for (int i = 0; i < 4; i++) {
            const long row = OFFSETS * k + i;
            for (int j = 0; j < 4; j++) own[4 * i + j] = t->prior[s * row + OFFSETS * k + j];
            own[5 * i] += *t->offset_floor * *t->offset_floor;
            off[i] = held[i] = t->offset[row] - t->prior_offset[row];
        }
        if (!root_of(4, own, root)) return 0;
        solve(4, root, held);
        t->strain[k] = off[0] * held[0] + off[1] * held[1] + off[2] * held[2] + off[3] * held[3];
    }
    return 1;
}

/* Whether it converges: nothing moves any more, and the outliers stay the same. */
EXPORT long corner_fit(const LensStruct *lens, const FitLimits *limits, long markers, long sheets, const long *sheet, double *given) {
    const Fit fit = fit_of(markers, sheets, sheet, given), *t = &fit;
    const long n = PIXELS * t->markers, d = POSE + OFFSETS * t->sheets, s = d - POSE;
    for (long k = 0; k < t->markers; k++) {
        const double *pixel = t->pixels + PIXELS * k;
        double center[2] = {0.0, 0.0};
        for (int i = 0; i < PIXELS; i++) center[i % 2] += pixel[i] / CORNERS;
        for (int i = 0; i < CORNERS; i++) {
            const double x = center[0] - pixel[2 * i], y = center[1] - pixel[2 * i + 1];
            const double length = at_least(sqrt(x * x + y * y), 1e-6);
            t->inward[PIXELS * k + 2 * i] = x / length;
            t->inward[PIXELS * k + 2 * i + 1] = y / length;
        }
    }
    for (long i = 0; i < n; i++) t->keep[i] = 1.0;
    if (s) {
        memcpy(t->full, t->prior, sizeof(double) * (size_t)(s * s));
        for (long i = 0; i < s; i++) t->full[(s + 1) * i] += *t->offset_floor * *t->offset_floor;
        if (!invert(s, t->full, t->factor, t->known)) return 0;
        memcpy(t->offset, t->prior_offset, sizeof(double) * (size_t)s);
    }
    int moved = 1;
    for (long step = 0; step < limits->steps; step++) {
        if (moved && !linearise(lens, t)) return 0;
        weigh(lens, limits, t);
        normal_equations(limits, t);
        if (!root_of(d, t->full, t->factor)) return 0;
        solve(d, t->factor, t->delta);
        int settled = 1;
        for (long i = 0; i < d; i++) settled = settled && (i == BLUR || fabs(t->delta[i]) < limits->converged);
        long columns[OWN];
        for (long k = 0; k < t->markers; k++) {
            const int own = columns_of(t, k, columns);
            for (long i = PIXELS * k; i < PIXELS * (k + 1); i++) {
                const double *row = t->rows + WIDTH * i;
                double by = 0.0;
                for (int a = 0; a < own; a++) by += row[a] * t->delta[columns[a]];
                t->left[i] = row[OWN] - by;
            }
        }
        moved = !(settled && !same_fit(limits, t, t->off, t->sorted) && step < limits->steps - 1);
        if (!moved) { /* the derivatives have not changed */
            for (long i = 0; i < n; i++) t->keep[i] = t->off[i / 2];
            continue;
        }
        move(t, t->delta);
        if (settled) return s ? pieces(limits, t) : 1;
    }
    return 0;
}

typedef struct {
    long markers, most;                           /* n of the picture; markers of one id */
    double eye[3], turn[9];                       /* of the camera; NED from camera */
    double floor_m;
    const double *pixels;                         /* (n, 4, 2) */
    const long *row, *candidates;                 /* (n) of the id, (ids, most) of the map, -1 = no more */
    const double *centers;                        /* (ids, most, 2) */
    long *taken;                                  /* (n) the nearest */
    double *shift, *rays;                         /* (n, 2) to its centre, (n, 3) in the camera's frame, z = 1 */
} MatchStruct;
LAYOUT(MatchStruct, markers, most, eye, turn, floor_m, pixels, row, candidates, centers, taken, shift, rays)

/* The nearest marker of its id to where each marker of a picture of a level floor lies. */
EXPORT void nearest_markers(const LensStruct *lens, long steps, const MatchStruct *t) {
    for (long k = 0; k < t->markers; k++) {
        double *ray = t->rays + 3 * k, center[2] = {0.0, 0.0}, down[3];
        for (int i = 0; i < PIXELS; i++) center[i % 2] += 0.25 * t->pixels[PIXELS * k + i];
        unbend(lens, 1, steps, center, ray);
        ray[2] = 1.0;
        for (int i = 0; i < 3; i++)
            down[i] = t->turn[3 * i] * ray[0] + t->turn[3 * i + 1] * ray[1] + t->turn[3 * i + 2];
        const double scale = (t->floor_m - t->eye[2]) / at_least(down[2], 0.1);
        const double north = t->eye[0] + scale * down[0], east = t->eye[1] + scale * down[1];
        const long *candidate = t->candidates + t->most * t->row[k];
        double nearest2 = HUGE_VAL;
        t->taken[k] = -1;
        t->shift[2 * k] = t->shift[2 * k + 1] = HUGE_VAL;
        for (long j = 0; j < t->most && candidate[j] >= 0; j++) {
            const double *at = t->centers + 2 * (t->most * t->row[k] + j);
            const double n = at[0] - north, e = at[1] - east, off2 = n * n + e * e;
            if (!(off2 < nearest2)) continue;
            nearest2 = off2;
            t->taken[k] = candidate[j];
            t->shift[2 * k] = n;
            t->shift[2 * k + 1] = e;
        }
    }
}
