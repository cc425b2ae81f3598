/* One control step of the NMPC: linearise at the guess, solve the quadratic program, write the new plan.
 *
 * The same problem as autopilot/control/nmpc/ocp.py (see there for the mathematics), solved by a primal-dual interior point
 * method (Mehrotra's predictor and corrector) whose linear algebra knows the structure: Riccati recursion over the
 * stages; thrust bounds are diagonal; every soft row looks at two or three states, and the two slacks of a stage are
 * eliminated by hand. Constant sizes, no allocation, no global state.
 *
 * Compiled once per number of thrusters and kind of processor by library.c's build (setup.py): `NU`, the number of
 * thrusters, stands in front of this file, and so does `model_slope` (model.c, generated from the model): dx/dt and its
 * Jacobian with respect to force and state, (x[8], force[4], current[3], coefficients[13]) -> (dx[8], J[8][4 + 8]). The
 * current along the plan does not depend on the place, so columns of x, y and z are zero.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "common.h"
#include "task.h"

enum { NX = 8, AXES = 4, NV = NX + NU, PLANES = 8, LIMITS = 5, FIRST_ACTIVE = 3 };

/* Inequalities of a stage: thrust above, thrust below, half-planes, depth, planar speed, heave, turn, two slacks; filled
 * up to a multiple of four. */
enum {
    UPPER = 0,
    LOWER = NU,
    PLANE = 2 * NU,
    DEPTH = PLANE + PLANES,
    SPEED,
    HEAVE,
    TURN,
    SLACK,
    USED = SLACK + 2,
    NI = (USED + 3) / 4 * 4
};
enum { OF_SPEEDS = 0, OF_PLACES = 1 };

static const double SPEED_EPSILON_M_S = 0.02;
static const int MAX_ITERATIONS = 30, MORE_ITERATIONS = 90;
static const double WIDER = 10.0; /* the second start */
static const double COMPLEMENTARITY = 1e-7; /* largest product of a multiplier and its distance that is left */
static const double FEASIBILITY = 1e-9;     /* largest residual of a row that is left */
static const double STATIONARITY = 1e-6;    /* largest residual of a gradient with respect to thrust or slack */
static const double TO_BOUNDARY = 0.995, CAREFUL = 0.9, SHORT_STEP = 0.1; /* careful: of the second start */
static const double START_PRODUCT = 30.0, START_DISTANCE_N = 0.5, START_SLACK = 0.02; /* of few iterations */
static const double LOOSER = 1e3; /* what is left when iterations or digits are used up may be this much larger */

typedef struct {
    double m[NX][NV], mt[NV][NX];       /* [B A] and its transpose */
    double e[NX], pe[NX];               /* residual of the dynamics; P of the next stage times that */
    double hx[NX], gx[NX], hu[NU], gu[NU]; /* diagonal Hessian and gradient at dx = 0, du = 0 */
    double nx[PLANES], ny[PLANES], cu, cv, sign_z, sign_w, sign_r;
    double h[NI];                       /* right-hand sides: G y + t = h */
    double t[NI], lam[NI], inv[NI], w[NI], eff[NI], rp[NI], dt[NI], dl[NI], corr[NI];
    double hs[2], gs[2], b0[4], b1[3];  /* slacks: Hessian, gradient, coupling with speeds and places */
    double k[NU][NX], kt[NX][NU], linv[NU][NU], y[NU][NX], l[NU];
    double x[NX], u[NU], s[2];          /* iterate */
    double dx[NX], du[NU], ds[2];       /* step */
    double l1, l2;
} Stage;

/* Of `work`: the stages and the gaps of the guess. */
long WORKSPACE_BYTES(long n) { return (long)sizeof(Stage) * (n + 1) + (long)sizeof(double) * NX * n; }

/* One Runge-Kutta step of order 4 of length h: next state and its Jacobian [B A] with respect to (u, x). */
static void runge_kutta(
    const Task *task, const double *x, const double *u, const double *c, double h, double *next, double m[NX][NV]) {
    static const double share[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    double slope[NX] = {0.0}, ds[NX][NV] = {{0.0}}, state[NX], force[AXES] = {0.0};
    for (int i = 0; i < AXES; i++)
        for (int v = 0; v < NU; v++) force[i] += task->allocation[NU * i + v] * u[v];
    memcpy(next, x, NX * sizeof(double));
    memset(m, 0, NX * sizeof *m);
    for (int i = 0; i < NX; i++) m[i][NU + i] = 1.0;
    for (int stage = 0; stage < 4; stage++) {
        double jacobian[NX][AXES + NX], chain[NX][NV] = {{0.0}};
        const double ahead = share[stage] * h;
        for (int i = 0; i < NX; i++) state[i] = x[i] + ahead * slope[i];
        const double *arg[4] = {state, force, c, task->coefficients};
        double *res[2] = {slope, &jacobian[0][0]};
        model_slope(arg, res, NULL, NULL, 0);
        for (int i = 0; i < NX; i++) {
            memcpy(chain[i] + NU, jacobian[i] + AXES, NX * sizeof(double));
            if (i >= NX - AXES) /* places change with velocities only */
                for (int a = 0; a < AXES; a++)
                    for (int v = 0; v < NU; v++) chain[i][v] += jacobian[i][a] * task->allocation[NU * a + v];
        }
        if (stage > 0)
            for (int i = 0; i < NX; i++)
                for (int j = FIRST_ACTIVE; j < NX; j++)
                    for (int v = 0; v < NV; v++) chain[i][v] += jacobian[i][AXES + j] * ahead * ds[j][v];
        memcpy(ds, chain, sizeof ds);
        for (int i = 0; i < NX; i++) {
            next[i] += weight[stage] * h * slope[i];
            for (int v = 0; v < NV; v++) m[i][v] += weight[stage] * h * ds[i][v];
        }
    }
}

static void linearise(const Task *task, Stage *st, double *gap_max) {
    for (long k = 0; k < task->n; k++, st++) {
        double next[NX];
        const double *x = task->x_guess + NX * k, *u = task->u_guess + NU * k, *c = task->current + 3 * k;
        runge_kutta(task, x, u, c, task->step_s[k], next, st->m);
        for (int more = 1; more < (int)task->steps[k]; more++) {
            double state[NX], before[NX][NV], m[NX][NV];
            memcpy(state, next, sizeof state);
            memcpy(before, st->m, sizeof before);
            runge_kutta(task, state, u, c, task->step_s[k], next, m);
            for (int i = 0; i < NX; i++) {
                double row[NV] = {0.0};
                for (int j = 0; j < NU; j++) row[j] = m[i][j];
                for (int j = 0; j < NX; j++)
                    for (int v = 0; v < NV; v++) row[v] += m[i][NU + j] * before[j][v];
                memcpy(st->m[i], row, sizeof row);
            }
        }
        for (int i = 0; i < NX; i++) {
            st->e[i] = next[i] - task->x_guess[NX * (k + 1) + i];
            *gap_max = at_least(fabs(st->e[i]), *gap_max);
            for (int v = 0; v < NV; v++) st->mt[v][i] = st->m[i][v];
        }
    }
}

static void set_rows(const Task *task, Stage *st, long k) {
    const double *x = task->x_guess + NX * k, *limit = task->limits + LIMITS * (k - 1);
    const double *n = task->plane_n + 2 * PLANES * (k - 1), *d = task->plane_d + PLANES * (k - 1);
    for (int i = 0; i < PLANES; i++) {
        st->nx[i] = -n[2 * i];
        st->ny[i] = -n[2 * i + 1];
        st->h[PLANE + i] = -(st->nx[i] * x[0] + st->ny[i] * x[1] + d[i]);
    }
    const double planar = sqrt(x[4] * x[4] + x[5] * x[5] + SPEED_EPSILON_M_S * SPEED_EPSILON_M_S);
    const int shallow = x[2] - limit[3] < limit[4] - x[2];
    st->cu = x[4] / planar;
    st->cv = x[5] / planar;
    st->sign_z = shallow ? -1.0 : 1.0;
    st->sign_w = x[6] < 0.0 ? -1.0 : 1.0;
    st->sign_r = x[7] < 0.0 ? -1.0 : 1.0;
    st->h[DEPTH] = -(st->sign_z * x[2] - (shallow ? -limit[3] : limit[4]));
    st->h[SPEED] = -(st->cu * x[4] + st->cv * x[5] - limit[0]);
    st->h[HEAVE] = -(st->sign_w * x[6] - limit[1]);
    st->h[TURN] = -(st->sign_r * x[7] - limit[2]);
}

/* G y of the rows for places and speeds, slacks included. */
static void apply_rows(const Stage *st, const double *x, const double *s, double *out) {
    for (int i = 0; i < PLANES; i++) out[PLANE + i] = st->nx[i] * x[0] + st->ny[i] * x[1] - s[OF_PLACES];
    out[DEPTH] = st->sign_z * x[2] - s[OF_PLACES];
    out[SPEED] = st->cu * x[4] + st->cv * x[5] - s[OF_SPEEDS];
    out[HEAVE] = st->sign_w * x[6] - s[OF_SPEEDS];
    out[TURN] = st->sign_r * x[7] - s[OF_SPEEDS];
}

/* G y of one stage for any vector: iterate or step. */
static void apply(const Stage *st, const double *x, const double *u, const double *s, long k, double *out) {
    for (int i = 0; i < NU; i++) {
        out[UPPER + i] = u[i];
        out[LOWER + i] = -u[i];
    }
    if (k == 0) return;
    apply_rows(st, x, s, out);
    out[SLACK] = -s[0];
    out[SLACK + 1] = -s[1];
}

static void prepare(const Task *task, Stage *st) {
    for (long k = 0; k < task->n; k++, st++) {
        const double scale = task->scale[k];
        const double *limit = task->thrust_limit + NU * k, *u = task->u_guess + NU * k, *ref = task->u_ref + NU * k;
        for (int i = 0; i < NI; i++) {
            st->h[i] = 0.0;
            st->t[i] = 1.0;
            st->lam[i] = st->rp[i] = st->dt[i] = st->dl[i] = st->corr[i] = 0.0;
        }
        memset(st->x, 0, sizeof st->x);
        memset(st->s, 0, sizeof st->s);
        memset(st->ds, 0, sizeof st->ds);
        for (int i = 0; i < NU; i++) {
            const double wanted = clamp(ref[i], -limit[i], limit[i]);
            st->hu[i] = scale * task->weight_u[NU * k + i];
            st->gu[i] = st->hu[i] * (u[i] - wanted);
            st->h[UPPER + i] = limit[i] - u[i];
            st->h[LOWER + i] = limit[i] + u[i];
            st->u[i] = 0.0;
        }
        st->l1 = scale * task->slack_l1;
        st->l2 = scale * task->slack_l2;
        if (k > 0) {
            const double *x = task->x_guess + NX * k, *to = task->x_ref + NX * k;
            for (int i = 0; i < NX; i++) {
                st->hx[i] = scale * task->weight_x[NX * (k - 1) + i];
                st->gx[i] = st->hx[i] * (x[i] - to[i]);
            }
            set_rows(task, st, k);
        }
    }
}

/* A start inside all bounds: thrusts a little away from theirs, slacks as large as the guess needs them. */
static void start(const Task *task, Stage *st, double wider) {
    const double mu = START_PRODUCT * wider, distance_n = START_DISTANCE_N * wider, slack = START_SLACK * wider;
    for (long k = 0; k < task->n; k++, st++) {
        for (int i = 0; i < 2 * NU; i++) {
            st->t[i] = at_least(st->h[i], distance_n);
            st->lam[i] = mu / st->t[i];
        }
        if (k == 0) continue;
        st->s[OF_PLACES] = st->s[OF_SPEEDS] = slack;
        for (int i = PLANE; i <= DEPTH; i++) st->s[OF_PLACES] = at_least(st->s[OF_PLACES], -st->h[i]);
        for (int i = SPEED; i <= TURN; i++) st->s[OF_SPEEDS] = at_least(st->s[OF_SPEEDS], -st->h[i]);
        for (int i = PLANE; i <= TURN; i++) {
            st->t[i] = at_least(st->h[i] + st->s[i <= DEPTH ? OF_PLACES : OF_SPEEDS], slack);
            st->lam[i] = mu / st->t[i];
        }
        for (int j = 0; j < 2; j++) {
            st->t[SLACK + j] = st->s[j];
            st->lam[SLACK + j] = mu / st->s[j];
        }
    }
}

/* Residuals of rows and dynamics, products, weights. Largest residual and product; the mean product. */
static double residuals(const Task *task, Stage *st, double *worst_row, double *worst_product) {
    double sum = 0.0, row = 0.0, product[NI] = {0.0}, total[NI] = {0.0};
    const long n = task->n;
    for (long k = 0; k < n; k++) {
        Stage *a = st + k;
        double g[NI] = {0.0};
        apply(a, a->x, a->u, a->s, k, g);
        if (k == 0)
            for (int i = PLANE; i < NI; i++) g[i] = -1.0; /* unused: t = 1, h = 0 */
        for (int i = USED; i < NI; i++) g[i] = -1.0;
        for (int i = 0; i < NI; i++) {
            a->rp[i] = g[i] + a->t[i] - a->h[i];
            a->inv[i] = 1.0 / a->t[i];
            a->w[i] = a->lam[i] * a->inv[i];
            const double p = a->lam[i] * a->t[i];
            total[i] += p;
            product[i] = p > product[i] ? p : product[i];
        }
        for (int i = 0; i < NI; i++) row = fabs(a->rp[i]) > row ? fabs(a->rp[i]) : row;
    }
    for (int i = 0; i < NI; i++) {
        sum += total[i];
        *worst_product = product[i] > *worst_product ? product[i] : *worst_product;
    }
    *worst_row = row;
    return sum / (double)(USED * n - (USED - 2 * NU));
}

/* What `count` rows c (weights w) that share a slack of Hessian h0 add to q (their `size` states begin at `first`), and
 * their coupling b with the slack. Sum w c c' - b b' / (h0 + sum w), written about the mean row so that nothing cancels.
 * Returns h0 + sum w. */
static inline double fold_slack(
    int count, int size, const double *c, const double *w, double h0, int first, double q[NX][NX], double *b) {
    double sum = 0.0, mean[4];
    for (int j = 0; j < size; j++) b[j] = 0.0;
    for (int i = 0; i < count; i++) {
        sum += w[i];
        for (int j = 0; j < size; j++) b[j] += w[i] * c[size * i + j];
    }
    for (int j = 0; j < size; j++) mean[j] = b[j] / sum;
    const double share = sum * (h0 / (h0 + sum));
    for (int j = 0; j < size; j++)
        for (int l = 0; l <= j; l++) {
            double v = share * mean[j] * mean[l];
            for (int i = 0; i < count; i++) v += w[i] * (c[size * i + j] - mean[j]) * (c[size * i + l] - mean[l]);
            q[first + j][first + l] += v;
            if (l < j) q[first + l][first + j] += v;
        }
    return h0 + sum;
}

/* Inequalities and slacks of a stage folded into the Hessian q of its state. */
static void fold(Stage *st, double q[NX][NX]) {
    double c[PLANES + 1][3];
    for (int i = 0; i < PLANES; i++) {
        c[i][0] = st->nx[i];
        c[i][1] = st->ny[i];
        c[i][2] = 0.0;
    }
    c[PLANES][0] = c[PLANES][1] = 0.0;
    c[PLANES][2] = st->sign_z;
    const double speeds[3][4] = {{st->cu, st->cv, 0.0, 0.0}, {0.0, 0.0, st->sign_w, 0.0}, {0.0, 0.0, 0.0, st->sign_r}};
    const double *w = st->w;
    st->hs[OF_PLACES] = fold_slack(PLANES + 1, 3, &c[0][0], w + PLANE, st->l2 + w[SLACK + OF_PLACES], 0, q, st->b1);
    st->hs[OF_SPEEDS] = fold_slack(3, 4, &speeds[0][0], w + SPEED, st->l2 + w[SLACK + OF_SPEEDS], 4, q, st->b0);
}

/* Riccati recursion: gains of every stage. Returns 0 when a pivot is not positive. */
static int factorise(const Task *task, Stage *st) {
    double p[NX][NX];
    memcpy(p, task->terminal, sizeof p);
    for (long k = task->n - 1; k >= 0; k--) {
        Stage *a = st + k;
        double pm[NX][NV] = {{0.0}}, h[NV][NV] = {{0.0}};
        for (int i = 0; i < NX; i++) a->pe[i] = 0.0;
        for (int j = 0; j < NX; j++)
            for (int i = 0; i < NX; i++) a->pe[i] += p[j][i] * a->e[j];
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < NX; j++)
                for (int v = 0; v < NV; v++) pm[i][v] += p[i][j] * a->m[j][v];
        for (int v = 0; v < NU; v++) h[v][v] = a->hu[v] + a->w[UPPER + v] + a->w[LOWER + v];
        for (int i = 0; i < NX; i++) {
            for (int v = 0; v < NU; v++)
                for (int c = 0; c < NV; c++) h[v][c] += a->m[i][v] * pm[i][c];
        }
        /* Cholesky factor of the thrust block, its inverse, Y = L^-1 H_ux, K = -L^-T Y */
        double l[NU][NU], li[NU][NU] = {{0.0}};
        for (int i = 0; i < NU; i++) {
            for (int j = 0; j <= i; j++) {
                double v = h[i][j];
                for (int c = 0; c < j; c++) v -= l[i][c] * l[j][c];
                if (i == j) {
                    if (!(v > 0.0)) return 0;
                    l[i][i] = sqrt(v);
                    li[i][i] = 1.0 / l[i][i];
                } else {
                    l[i][j] = v * li[j][j];
                }
            }
        }
        for (int i = 1; i < NU; i++)
            for (int j = 0; j < i; j++) {
                double v = 0.0;
                for (int c = j; c < i; c++) v -= l[i][c] * li[c][j];
                li[i][j] = v * li[i][i];
            }
        memcpy(a->linv, li, sizeof li);
        if (k == 0) break;
        double y[NU][NX] = {{0.0}}, gain[NU][NX] = {{0.0}};
        for (int i = 0; i < NU; i++)
            for (int j = 0; j <= i; j++)
                for (int c = 0; c < NX; c++) y[i][c] += li[i][j] * h[j][NU + c];
        for (int i = 0; i < NU; i++)
            for (int j = i; j < NU; j++)
                for (int c = 0; c < NX; c++) gain[i][c] -= li[j][i] * y[j][c];
        memcpy(a->y, y, sizeof y);
        for (int i = 0; i < NU; i++)
            for (int c = 0; c < NX; c++) a->kt[c][i] = gain[i][c];
        for (int i = 0; i < NX; i++)
            for (int c = 0; c < NX; c++) p[i][c] = 0.0;
        for (int i = 0; i < NX; i++) p[i][i] = a->hx[i];
        fold(a, p);
        for (int i = 0; i < NX; i++)
            for (int r = 0; r < NX; r++)
                for (int c = 0; c < NX; c++) p[r][c] += a->mt[NU + r][i] * pm[i][NU + c];
        for (int i = 0; i < NU; i++)
            for (int r = 0; r < NX; r++)
                for (int c = 0; c < NX; c++) p[r][c] -= y[i][r] * y[i][c];
        for (int r = 0; r < NX; r++)
            for (int c = 0; c < r; c++) p[r][c] = p[c][r] = 0.5 * (p[r][c] + p[c][r]);
    }
    return 1;
}

/* Step for the effective multipliers in `eff`; leaves the steps of distances and multipliers behind. */
static void solve(const Task *task, Stage *st, const double *terminal_gradient) {
    const long n = task->n;
    double p[NX];
    memcpy(p, terminal_gradient, sizeof p);
    for (long k = n - 1; k >= 0; k--) {
        Stage *a = st + k;
        const double *eff = a->eff;
        double g[NV], q[NX];
        for (int i = 0; i < NX; i++) q[i] = p[i] + a->pe[i];
        for (int i = 0; i < NU; i++) g[i] = a->gu[i] + a->hu[i] * a->u[i] + eff[UPPER + i] - eff[LOWER + i];
        for (int i = 0; i < NX; i++) g[NU + i] = a->gx[i] + a->hx[i] * a->x[i];
        if (k > 0) {
            double x = 0.0, y = 0.0, sum = 0.0;
            for (int i = 0; i < PLANES; i++) {
                x += eff[PLANE + i] * a->nx[i];
                y += eff[PLANE + i] * a->ny[i];
                sum += eff[PLANE + i];
            }
            a->gs[OF_PLACES] = a->l1 + a->l2 * a->s[OF_PLACES] - eff[SLACK + OF_PLACES] - sum - eff[DEPTH];
            a->gs[OF_SPEEDS] =
                a->l1 + a->l2 * a->s[OF_SPEEDS] - eff[SLACK + OF_SPEEDS] - eff[SPEED] - eff[HEAVE] - eff[TURN];
            const double f1 = a->gs[OF_PLACES] / a->hs[OF_PLACES], f0 = a->gs[OF_SPEEDS] / a->hs[OF_SPEEDS];
            g[NU + 0] += x + a->b1[0] * f1;
            g[NU + 1] += y + a->b1[1] * f1;
            g[NU + 2] += a->sign_z * eff[DEPTH] + a->b1[2] * f1;
            g[NU + 4] += a->cu * eff[SPEED] + a->b0[0] * f0;
            g[NU + 5] += a->cv * eff[SPEED] + a->b0[1] * f0;
            g[NU + 6] += a->sign_w * eff[HEAVE] + a->b0[2] * f0;
            g[NU + 7] += a->sign_r * eff[TURN] + a->b0[3] * f0;
        }
        for (int i = 0; i < NX; i++)
            for (int v = 0; v < NV; v++) g[v] += a->m[i][v] * q[i];
        double l[NU];
        for (int i = 0; i < NU; i++) {
            l[i] = 0.0;
            for (int j = 0; j <= i; j++) l[i] += a->linv[i][j] * g[j];
        }
        for (int i = 0; i < NU; i++) {
            a->l[i] = 0.0;
            for (int j = i; j < NU; j++) a->l[i] -= a->linv[j][i] * l[j];
        }
        if (k == 0) break;
        for (int c = 0; c < NX; c++) p[c] = g[NU + c];
        for (int i = 0; i < NU; i++)
            for (int c = 0; c < NX; c++) p[c] -= a->y[i][c] * l[i];
    }
    memset(st->dx, 0, sizeof st->dx);
    for (long k = 0; k < n; k++) {
        Stage *a = st + k, *b = a + 1;
        double g[NI] = {0.0}, du[NU], dx[NX];
        for (int i = 0; i < NU; i++) du[i] = a->l[i];
        if (k > 0) {
            for (int j = 0; j < NX; j++)
                for (int i = 0; i < NU; i++) du[i] += a->kt[j][i] * a->dx[j];
            const double *d = a->dx;
            a->ds[OF_PLACES] =
                (a->b1[0] * d[0] + a->b1[1] * d[1] + a->b1[2] * d[2] - a->gs[OF_PLACES]) / a->hs[OF_PLACES];
            a->ds[OF_SPEEDS] = (a->b0[0] * d[4] + a->b0[1] * d[5] + a->b0[2] * d[6] + a->b0[3] * d[7] -
                                a->gs[OF_SPEEDS]) /
                               a->hs[OF_SPEEDS];
        }
        memcpy(a->du, du, sizeof du);
        for (int i = 0; i < NX; i++) dx[i] = a->e[i];
        for (int v = 0; v < NU; v++)
            for (int i = 0; i < NX; i++) dx[i] += a->mt[v][i] * du[v];
        if (k > 0)
            for (int v = 0; v < NX; v++)
                for (int i = 0; i < NX; i++) dx[i] += a->mt[NU + v][i] * a->dx[v];
        memcpy(b->dx, dx, sizeof dx);
        apply(a, a->dx, a->du, a->ds, k, g);
        for (int i = 0; i < NI; i++) {
            a->dt[i] = -a->rp[i] - g[i];
            a->dl[i] = a->eff[i] - a->lam[i] + a->w[i] * g[i];
        }
    }
}

/* How far the step may go before a distance and a multiplier would become zero: 1 / largest ratio. */
static void reach(const Task *task, const Stage *st, double *primal, double *dual) {
    double a[NI] = {0.0}, b[NI] = {0.0};
    for (long k = 0; k < task->n; k++, st++)
        for (int i = 0; i < NI; i++) {
            const double p = -st->dt[i] * st->inv[i], q = -st->dl[i] / (st->lam[i] + 1e-300);
            a[i] = p > a[i] ? p : a[i];
            b[i] = q > b[i] ? q : b[i];
        }
    double p = 1e-9, d = 1e-9;
    for (int i = 0; i < NI; i++) {
        p = a[i] > p ? a[i] : p;
        d = b[i] > d ? b[i] : d;
    }
    *primal = 1.0 / p;
    *dual = 1.0 / d;
}

/* Largest component of the gradient of the Lagrangian with respect to thrust and slacks; the costates that make it
 * zero with respect to the states come from the end. */
static double stationarity(const Task *task, const Stage *st, const double *terminal_gradient) {
    double nu[NX], worst = 0.0;
    memcpy(nu, terminal_gradient, sizeof nu);
    for (long k = task->n - 1; k >= 0; k--) {
        const Stage *a = st + k;
        const double *lam = a->lam;
        double g[NV];
        for (int i = 0; i < NU; i++) g[i] = a->gu[i] + a->hu[i] * a->u[i] + lam[UPPER + i] - lam[LOWER + i];
        for (int i = 0; i < NX; i++) g[NU + i] = a->gx[i] + a->hx[i] * a->x[i];
        for (int i = 0; i < NX; i++)
            for (int v = 0; v < NV; v++) g[v] += a->m[i][v] * nu[i];
        for (int i = 0; i < NU; i++) worst = at_least(fabs(g[i]), worst);
        if (k == 0) break;
        double places = a->l1 + a->l2 * a->s[OF_PLACES] - lam[SLACK + OF_PLACES] - lam[DEPTH];
        for (int i = 0; i < PLANES; i++) {
            g[NU + 0] += lam[PLANE + i] * a->nx[i];
            g[NU + 1] += lam[PLANE + i] * a->ny[i];
            places -= lam[PLANE + i];
        }
        const double speeds =
            a->l1 + a->l2 * a->s[OF_SPEEDS] - lam[SLACK + OF_SPEEDS] - lam[SPEED] - lam[HEAVE] - lam[TURN];
        worst = at_least(at_least(fabs(places), fabs(speeds)), worst);
        g[NU + 2] += a->sign_z * lam[DEPTH];
        g[NU + 4] += a->cu * lam[SPEED];
        g[NU + 5] += a->cv * lam[SPEED];
        g[NU + 6] += a->sign_w * lam[HEAVE];
        g[NU + 7] += a->sign_r * lam[TURN];
        memcpy(nu, g + NU, sizeof nu);
    }
    return worst;
}

static void terminal_gradient_at(const Task *task, const double *dx, double *out) {
    const double *x = task->x_guess + NX * task->n, *ref = task->x_ref + NX * task->n;
    for (int i = 0; i < NX; i++) out[i] = 0.0;
    for (int j = 0; j < NX; j++)
        for (int i = 0; i < NX; i++) out[i] += task->terminal[NX * j + i] * (x[j] - ref[j] + dx[j]);
}

static void dynamics_residual(const Task *task, Stage *st, const double *gap) {
    for (long k = 0; k < task->n; k++) {
        Stage *a = st + k, *b = a + 1;
        for (int i = 0; i < NX; i++) a->e[i] = gap[NX * k + i] - b->x[i];
        for (int v = 0; v < NU; v++)
            for (int i = 0; i < NX; i++) a->e[i] += a->mt[v][i] * a->u[v];
        for (int v = 0; v < NX; v++)
            for (int i = 0; i < NX; i++) a->e[i] += a->mt[NU + v][i] * a->x[v];
    }
}

static double largest_gap(const Task *task, const Stage *st) {
    double worst = 0.0;
    for (long k = 0; k < task->n; k++)
        for (int i = 0; i < NX; i++) worst = at_least(fabs(st[k].e[i]), worst);
    return worst;
}

/* Results and figures (see ocp.build_qp_step): cost, row violation, gap, thrust overshoot, sum, use of the penalty. */
static void write_out(const Task *task, const Stage *st, double gap_max, int iterations, double unsolved) {
    const long n = task->n;
    double cost = 0.0, violation = unsolved > 0.0 ? INFINITY : 0.0, overshoot = -INFINITY, sum = 0.0, use = 0.0;
    memcpy(task->x, task->x_guess, NX * sizeof(double));
    for (long k = 0; k < n; k++) {
        const Stage *a = st + k;
        for (int i = 0; i < NU; i++) {
            const double limit = task->thrust_limit[NU * k + i], u = task->u_guess[NU * k + i] + a->u[i];
            overshoot = at_least(fabs(u) - limit, overshoot);
            sum += a->u[i];
            cost += (0.5 * a->hu[i] * a->u[i] + a->gu[i]) * a->u[i];
            task->u[NU * k + i] = u > limit ? limit : (u < -limit ? -limit : u);
        }
        for (int i = 0; i < NX; i++) violation = at_least(fabs(a->e[i]), violation);
        if (k == 0) continue;
        double g[NI];
        apply_rows(a, a->x, a->s, g);
        for (int i = PLANE; i <= TURN; i++) {
            violation = at_least(g[i] - a->h[i], violation);
            use = at_least(a->lam[i] / a->l1, use);
        }
        for (int i = 0; i < NX; i++) {
            sum += a->x[i];
            cost += (0.5 * a->hx[i] * a->x[i] + a->gx[i]) * a->x[i];
            task->x[NX * k + i] = task->x_guess[NX * k + i] + a->x[i];
        }
        for (int j = 0; j < 2; j++) {
            sum += a->s[j];
            cost += (0.5 * a->l2 * a->s[j] + a->l1) * a->s[j];
            task->slack[2 * (k - 1) + j] = a->s[j];
        }
    }
    double before[NX], zero[NX] = {0.0}, after[NX];
    terminal_gradient_at(task, zero, before);
    terminal_gradient_at(task, st[n].x, after);
    for (int i = 0; i < NX; i++) {
        sum += st[n].x[i];
        cost += 0.5 * (before[i] + after[i]) * st[n].x[i];
        task->x[NX * n + i] = task->x_guess[NX * n + i] + st[n].x[i];
    }
    const double figures[] = {cost, violation, gap_max, overshoot, sum, use, (double)iterations, unsolved};
    memcpy(task->figures, figures, sizeof figures);
}

/* Interior point iterations from a start, `most` at most; a step goes `share_of_way` of the way to the boundary. Returns their
 * number; `unsolved` becomes 0 if they converge. */
static int iterate(
    const Task *task, Stage *st, const double *gap, double wider, double share_of_way, int most, double *unsolved) {
    const long n = task->n;
    double gradient[NX];
    prepare(task, st);
    memset(st[n].x, 0, sizeof st[n].x);
    start(task, st, wider);
    dynamics_residual(task, st, gap);
    double last_alpha = 1.0;
    int iteration = 0;
    for (;; iteration++) {
        double row = 0.0, product = 0.0;
        if (iteration > 0) dynamics_residual(task, st, gap);
        const double mu = residuals(task, st, &row, &product);
        terminal_gradient_at(task, st[n].x, gradient);
        if (!(mu < 1e300)) break;
        double left = at_least(product / COMPLEMENTARITY, at_least(largest_gap(task, st), row) / FEASIBILITY);
        if (left < LOOSER) left = at_least(stationarity(task, st, gradient) / STATIONARITY, left);
        if (left < 1.0 || iteration == most || !factorise(task, st)) {
            if (left < LOOSER) *unsolved = 0.0;
            break;
        }
        for (long k = 0; k < n; k++)
            for (int i = 0; i < NI; i++) st[k].eff[i] = st[k].w[i] * st[k].rp[i];
        solve(task, st, gradient);
        double primal, dual;
        reach(task, st, &primal, &dual);
        primal = primal < 1.0 ? primal : 1.0;
        dual = dual < 1.0 ? dual : 1.0;
        double total[NI] = {0.0}, affine = 0.0;
        for (long k = 0; k < n; k++)
            for (int i = 0; i < NI; i++)
                total[i] += (st[k].t[i] + primal * st[k].dt[i]) * (st[k].lam[i] + dual * st[k].dl[i]);
        for (int i = 0; i < NI; i++) affine += total[i];
        affine /= (double)(USED * n - (USED - 2 * NU));
        /* After a short step the products are too uneven for the second-order term: go for the centre first. */
        const int stuck = last_alpha < SHORT_STEP;
        const double share = affine / mu, target = stuck ? 0.5 * mu : mu * share * share * share;
        for (long k = 0; k < n; k++) {
            Stage *a = st + k;
            const int used = k == 0 ? PLANE : NI;
            for (int i = 0; i < used; i++) {
                const double centre = i < USED ? target - (stuck ? 0.0 : a->dt[i] * a->dl[i]) : 0.0;
                a->eff[i] = a->w[i] * a->rp[i] + centre * a->inv[i];
            }
        }
        solve(task, st, gradient);
        reach(task, st, &primal, &dual);
        const double both = primal < dual ? primal : dual;
        const double alpha = share_of_way * both < 1.0 ? share_of_way * both : 1.0;
        last_alpha = alpha;
        for (long k = 0; k <= n; k++) {
            Stage *a = st + k;
            for (int i = 0; i < NX; i++) a->x[i] += alpha * a->dx[i];
            if (k == n) break;
            for (int i = 0; i < NU; i++) a->u[i] += alpha * a->du[i];
            for (int j = 0; j < 2; j++) a->s[j] += alpha * a->ds[j];
            for (int i = 0; i < NI; i++) {
                a->t[i] += alpha * a->dt[i];
                a->lam[i] += alpha * a->dl[i];
            }
        }
    }
    return iteration;
}

/* The step. Figures 6 and 7 are the iterations and what is left unsolved (0 = converged, else 1). A start that leads
 * nowhere is followed by one farther inside that stays away from the boundaries: programs far from their guess, with
 * weights or thrusts that differ by orders of magnitude, jam against them. */
void CONTROL_STEP(const Task *task) {
    Stage *st = (Stage *)task->work;
    double gap_max = 0.0, unsolved = 1.0;
    double *gap = (double *)(st + task->n + 1);
    linearise(task, st, &gap_max);
    for (long k = 0; k < task->n; k++) memcpy(gap + NX * k, st[k].e, NX * sizeof(double));
    int iterations = iterate(task, st, gap, 1.0, TO_BOUNDARY, MAX_ITERATIONS, &unsolved);
    if (unsolved > 0.0) iterations += iterate(task, st, gap, WIDER, CAREFUL, MORE_ITERATIONS, &unsolved);
    write_out(task, st, gap_max, iterations, unsolved);
}
