/* A learned flow and the forecast of currents by it (autopilot/control/current/current_learning.py). */
#include <math.h>

#include "common.h"

/* At one place, of cells (n, 2) that pull by (2, n): the curl of a streamfunction with a Gaussian kernel. */
static void flow_here(double x, double y, long n, const double *cells, const double *pull, double length_m, const double *mean,
                      double *out) {
    const double scale = 1.0 / length_m;
    double north = mean[0], east = mean[1];
    for (long i = 0; i < n; i++) {
        const double dx = (x - cells[2 * i]) * scale, dy = (y - cells[2 * i + 1]) * scale;
        const double bell = exp(-0.5 * (dx * dx + dy * dy)), across = bell * dx * dy;
        north += bell * (1.0 - dy * dy) * pull[i] + across * pull[n + i];
        east += bell * (1.0 - dx * dx) * pull[n + i] + across * pull[i];
    }
    out[0] = north;
    out[1] = east;
}

/* out (m, 2) at places (m, `stride` doubles apart) of cells (n, 2) that pull by (2, n). */
EXPORT void flow_at(long m, const double *places, long stride, long n, const double *cells, const double *pull, double length_m,
                    const double *mean, double *out) {
    for (long k = 0; k < m; k++)
        flow_here(places[stride * k], places[stride * k + 1], n, cells, pull, length_m, mean, out + 2 * k);
}

typedef struct {
    long m, stride, cells;
    double length_m, trust, scale_m, full_within_m, lasting_s, fade_s;
    const double *places, *t_s, *here, *estimate; /* (m, stride), (m), (3), (3) */
    const double *cell, *pull, *mean;             /* of the flow */
    double *out;                                  /* (m, 3) */
} Forecast;
LAYOUT(Forecast, m, stride, cells, length_m, trust, scale_m, full_within_m, lasting_s, fade_s, places, t_s, here, estimate, cell,
       pull, mean, out)

/* Currents at places and times: the flow as far as it is trusted, corrected by what the estimate says it lacks here. */
EXPORT void fill_currents(const Forecast *a) {
    double here[2];
    flow_here(a->here[0], a->here[1], a->cells, a->cell, a->pull, a->length_m, a->mean, here);
    for (long k = 0; k < a->m; k++) {
        const double *place = a->places + a->stride * k;
        const double x = place[0] - a->here[0], y = place[1] - a->here[1], z = place[2] - a->here[2];
        const double way = at_least(sqrt(x * x + y * y + z * z) - a->full_within_m, 0.0) / a->scale_m;
        const double share = exp(-0.5 * way * way - at_least(a->t_s[k] - a->lasting_s, 0.0) / a->fade_s);
        double flow[2];
        flow_here(place[0], place[1], a->cells, a->cell, a->pull, a->length_m, a->mean, flow);
        for (int i = 0; i < 2; i++)
            a->out[3 * k + i] = a->estimate[i] + a->trust * (flow[i] - a->estimate[i] + share * (a->estimate[i] - here[i]));
        a->out[3 * k + 2] = a->estimate[2];
    }
}
