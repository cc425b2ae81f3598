/* What a step is told and what it answers; the struct of autopilot/control/nmpc/solver.py. */
#ifndef TASK_H
#define TASK_H

typedef struct {
    long n, thrusters;
    double slack_l1, slack_l2;
    const double *coefficients, *allocation; /* of the model: mass, linear, quadratic drag (4 each), buoyancy; 4 x NU */
    const double *step_s, *steps, *scale;    /* per interval: length and number of RK steps, weight of the stage */
    const double *x_guess, *u_guess, *x_ref, *u_ref, *current, *weight_x, *weight_u, *terminal, *limits, *thrust_limit,
        *plane_n, *plane_d;
    double *x, *u, *slack, *figures, *work;
} Task;

#endif
