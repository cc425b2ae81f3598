/* A learned flow at many places; the same numbers as `Fit.flow` in autopilot/control/water/current_learning.py, which says
 * what they mean and is used without this library; tests/control/test_compiled_follow.py holds them against each other. */
#include <math.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* out (m, 2) at places (m, `stride` doubles apart) of cells (n, 2) that pull by (2, n). */
EXPORT void flow_at(long m, const double *places, long stride, long n, const double *cells, const double *pull, double length_m,
                    const double *mean, double *out) {
    const double scale = 1.0 / length_m;
    for (long k = 0; k < m; k++) {
        double north = mean[0], east = mean[1];
        for (long i = 0; i < n; i++) {
            const double dx = (places[stride * k] - cells[2 * i]) * scale, dy = (places[stride * k + 1] - cells[2 * i + 1]) * scale;
            const double bell = exp(-0.5 * (dx * dx + dy * dy)), across = bell * dx * dy;
            north += bell * (1.0 - dy * dy) * pull[i] + across * pull[n + i];
            east += bell * (1.0 - dx * dx) * pull[n + i] + across * pull[i];
        }
        out[2 * k] = north;
        out[2 * k + 1] = east;
    }
}
