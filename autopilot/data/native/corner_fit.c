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

enum { POSE = 7, BLUR = 6, OFFSETS = 4, OWN = POSE + OFFSETS, CORNERS = 4, PIXELS = 2 * CORNERS };

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

typedef struct {
    long markers, sheets;                      /* m, s; no sheets: the map is exact. d = 7 + 4 s unknowns */
    double tilt, shrink_prior;
    double pos[3], rotation[9], up[3], shrink; /* changed, but for up */
    const double *corners, *pixels, *expected; /* (m, 4, 3), (m, 4, 2), (m, 4, 2) */
    const long *sheet;                         /* (m), -1 = none */
    const double *pivot, *print_sigma, *prior; /* (s, 3), (m), (4 s, 4 s) information */
    const double *prior_offset;                /* (4 s) */
    double *offset;                            /* (4 s), changed */
    double *jacobian;                          /* (8 m, d), zero at first */
    double *information, *full;                /* (d, d) without and with the offsets' prior */
    double *left, *weight, *keep;              /* (8 m) */
    double *work;                              /* (25 m + d + d d) */
} FitStruct;
LAYOUT(FitStruct, markers, sheets, tilt, shrink_prior, pos, rotation, up, shrink, corners, pixels, expected, sheet,
       pivot, print_sigma, prior, prior_offset, offset, jacobian, information, full, left, weight, keep, work)

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

/* Residuals without blur, derivatives, and the depths of the markers' first corners; 0 if a corner is too near. */
static int linearise(const LensStruct *lens, const FitStruct *t, double *residual, double *depth) {
    const long d = POSE + OFFSETS * t->sheets;
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
            if (corner == 0) depth[m] = point[2];
            for (int i = 0; i < 3; i++) arm[i] = point[i] - t->pos[i];
            for (int i = 0; i < 3; i++)
                cam[i] = arm[0] * cam_from_ned[i][0] + arm[1] * cam_from_ned[i][1] + arm[2] * cam_from_ned[i][2] - lever[i];
            if (!(cam[2] > lens->near_m)) return 0;
            const double x = cam[0] / cam[2], y = cam[1] / cam[2];
            double bent[2], slope[3];
            bend(lens->distortion, x, y, bent, slope);
            for (int axis = 0; axis < 2; axis++) {
                const double f = lens->focal[axis];
                residual[2 * row + axis] = t->pixels[2 * row + axis] - (f * bent[axis] + lens->center[axis]);
                const double by_x = f * slope[axis ? 2 : 0] / cam[2], by_y = f * slope[axis ? 1 : 2] / cam[2];
                const double by_z = -(by_x * x + by_y * y);
                double g[3], *jac = t->jacobian + d * (2 * row + axis);
                for (int i = 0; i < 3; i++)
                    g[i] = by_x * cam_from_ned[0][i] + by_y * cam_from_ned[1][i] + by_z * cam_from_ned[2][i];
                for (int i = 0; i < 3; i++) jac[i] = -g[i];
                jac[3] = g[1] * arm[2] - g[2] * arm[1];
                jac[4] = g[2] * arm[0] - g[0] * arm[2];
                jac[5] = g[0] * arm[1] - g[1] * arm[0];
                if (move) {
                    double *own = jac + POSE + OFFSETS * sheet;
                    for (int i = 0; i < 3; i++) own[i] = g[i];
                    own[3] = g[1] * turned[0] - g[0] * turned[1];
                }
            }
        }
    }
    return 1;
}

/* Ratios of measured to expected standard deviation of corners, and of the variances of markers on their sheets. */
static void scatter(const FitLimits *limits, const FitStruct *t, const double *print_px, double ratios[2]) {
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
static void weigh(const LensStruct *lens, const FitLimits *limits, const FitStruct *t, const double *depth, double *print_px) {
    if (!t->sheets) {
        for (long i = 0; i < PIXELS * t->markers; i++) t->weight[i] = t->keep[i] / (t->expected[i] * t->expected[i]);
        return;
    }
    double ratios[2];
    for (long m = 0; m < t->markers; m++)
        print_px[m] = t->print_sigma[m] * lens->focal_water / at_least(depth[m] - t->pos[2], 0.05);
    scatter(limits, t, print_px, ratios);
    for (long m = 0; m < t->markers; m++) {
        const double corner = ratios[0] * t->expected[PIXELS * m];
        const double weight = 1.0 / (corner * corner + 4.0 * ratios[1] * print_px[m] * print_px[m]);
        for (int i = 0; i < PIXELS; i++) t->weight[PIXELS * m + i] = weight * t->keep[PIXELS * m + i];
    }
}

/* J' W J and J' W r. */
static void sums(const FitStruct *t, const double *residual, double *gradient) {
    const long d = POSE + OFFSETS * t->sheets;
    memset(t->information, 0, sizeof(double) * (size_t)(d * d));
    memset(gradient, 0, sizeof(double) * (size_t)d);
    for (long m = 0; m < t->markers; m++) {
        const long sheet = t->sheets ? t->sheet[m] : -1;
        const int own = sheet < 0 ? POSE : OWN;
        double block[OWN][OWN] = {{0.0}}, toward[OWN] = {0.0};
        for (int i = 0; i < PIXELS; i++) {
            const double *jac = t->jacobian + d * (PIXELS * m + i), weight = t->weight[PIXELS * m + i];
            double row[OWN];
            memcpy(row, jac, sizeof(double) * POSE);
            if (sheet >= 0) memcpy(row + POSE, jac + POSE + OFFSETS * sheet, sizeof(double) * OFFSETS);
            for (int a = 0; a < own; a++) {
                const double weighted = row[a] * weight;
                toward[a] += weighted * residual[PIXELS * m + i];
                for (int b = 0; b <= a; b++) block[a][b] += weighted * row[b];
            }
        }
        for (int a = 0; a < own; a++) {
            const long row = a < POSE ? a : a + OFFSETS * sheet;
            gradient[row] += toward[a];
            for (int b = 0; b <= a; b++) t->information[d * row + (b < POSE ? b : b + OFFSETS * sheet)] += block[a][b];
        }
    }
}

/* Information with and without the offsets' prior, and the gradient of everything. */
static void normal_equations(const FitLimits *limits, const FitStruct *t, const double *residual, double *gradient) {
    const long d = POSE + OFFSETS * t->sheets, s = d - POSE;
    sums(t, residual, gradient);
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
    } else {
        memcpy(t->full, t->information, sizeof(double) * (size_t)(d * d));
    }
    double *with_prior[2] = {t->full, t->sheets ? t->information : NULL}, lean[2];
    for (int i = 0; i < 2; i++)
        lean[i] = t->rotation[3 * i] * t->up[0] + t->rotation[3 * i + 1] * t->up[1] + t->rotation[3 * i + 2] * t->up[2];
    for (int i = 0; i < 2; i++) {
        if (!with_prior[i]) continue;
        with_prior[i][d * 3 + 3] += t->tilt;
        with_prior[i][d * 4 + 4] += t->tilt;
        with_prior[i][d * BLUR + BLUR] += limits->shrink_information;
    }
    gradient[3] += t->tilt * lean[1];
    gradient[4] -= t->tilt * lean[0];
    gradient[BLUR] += limits->shrink_information * (t->shrink_prior - t->shrink);
    for (long i = 0; i < s; i++)
        for (long j = 0; j < s; j++) {
            if (j <= i) t->full[d * (POSE + i) + POSE + j] += t->prior[s * i + j];
            gradient[POSE + i] += t->prior[s * i + j] * (t->prior_offset[j] - t->offset[j]);
        }
    for (long i = 0; i < d; i++)
        for (long j = 0; j < i; j++) {
            t->information[d * j + i] = t->information[d * i + j];
            t->full[d * j + i] = t->full[d * i + j];
        }
}

/* The solution in place of b, by Cholesky; 0 if the matrix is not positive definite. */
static int solve(long n, const double *a, double *factor, double *b) {
    for (long i = 0; i < n; i++) {
        double *row = factor + n * i;
        for (long j = 0; j <= i; j++) {
            const double *other = factor + n * j;
            double sum = a[n * i + j];
            for (long k = 0; k < j; k++) sum -= row[k] * other[k];
            if (j < i)
                row[j] = sum / other[j];
            else if (sum > 0.0)
                row[i] = sqrt(sum);
            else
                return 0;
        }
        for (long k = 0; k < i; k++) b[i] -= row[k] * b[k];
        b[i] /= row[i];
    }
    for (long i = n - 1; i >= 0; i--) {
        b[i] /= factor[n * i + i];
        for (long k = 0; k < i; k++) b[k] -= factor[n * i + k] * b[i];
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
static int same_fit(const FitLimits *limits, const FitStruct *t, double *off, double *sorted) {
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

static void move(FitStruct *t, const double *delta) {
    const double a = delta[3], b = delta[4], c = delta[5], angle = sqrt(a * a + b * b + c * c);
    for (int i = 0; i < 3; i++) t->pos[i] += delta[i];
    t->shrink += delta[BLUR];
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

/* Whether it converges: nothing moves any more, and the outliers stay the same. */
EXPORT long corner_fit(const LensStruct *lens, const FitLimits *limits, FitStruct *t) {
    const long m = t->markers, n = PIXELS * m, d = POSE + OFFSETS * t->sheets;
    double *residual = t->work, *inward = residual + n, *off = inward + n, *sorted = off + n / 2;
    double *depth = sorted + n / 2, *delta = depth + m, *factor = delta + d;
    for (long k = 0; k < m; k++) {
        const double *pixel = t->pixels + PIXELS * k;
        double center[2] = {0.0, 0.0};
        for (int i = 0; i < PIXELS; i++) center[i % 2] += pixel[i] / CORNERS;
        for (int i = 0; i < CORNERS; i++) {
            const double x = center[0] - pixel[2 * i], y = center[1] - pixel[2 * i + 1];
            const double length = at_least(sqrt(x * x + y * y), 1e-6);
            inward[PIXELS * k + 2 * i] = x / length;
            inward[PIXELS * k + 2 * i + 1] = y / length;
        }
    }
    for (long i = 0; i < n; i++) {
        t->keep[i] = 1.0;
        t->jacobian[d * i + BLUR] = inward[i];
    }
    int moved = 1;
    for (long step = 0; step < limits->steps; step++) {
        if (moved) {
            if (!linearise(lens, t, residual, depth)) return 0;
            for (long i = 0; i < n; i++) t->left[i] = residual[i] -= t->shrink * inward[i];
        }
        weigh(lens, limits, t, depth, off);
        normal_equations(limits, t, residual, delta);
        if (!solve(d, t->full, factor, delta)) return 0;
        int settled = 1;
        for (long i = 0; i < d; i++) settled = settled && (i == BLUR || fabs(delta[i]) < limits->converged);
        for (long i = 0; i < n; i++) {
            const double *jac = t->jacobian + d * i;
            const long sheet = t->sheets ? t->sheet[i / PIXELS] : -1;
            double by = 0.0;
            for (int k = 0; k < POSE; k++) by += jac[k] * delta[k];
            for (int k = 0; sheet >= 0 && k < OFFSETS; k++)
                by += jac[POSE + OFFSETS * sheet + k] * delta[POSE + OFFSETS * sheet + k];
            t->left[i] = residual[i] - by;
        }
        moved = 1;
        if (settled && !same_fit(limits, t, off, sorted) && step < limits->steps - 1) moved = 0;
        if (!moved) {
            for (long i = 0; i < n; i++) t->keep[i] = off[i / 2];
            continue;
        }
        move(t, delta);
        if (settled) return 1;
    }
    return 0;
}
