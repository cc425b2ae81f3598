/* What the library offers: the step for every number of thrusters, for the processor at hand.
 *
 * One file serves all vehicles and all processors of an architecture: `VARIANTS` (in front of this file, see setup.py)
 * lists the compiled steps as VARIANT(thrusters, kind), kind `plain` or, on x86-64, `wide` (AVX2 and FMA).
 */
#include "common.h"
#include "task.h"

#define VARIANT(thrusters, kind)                       \
    void control_step_##thrusters##_##kind(const Task *); \
    long workspace_bytes_##thrusters##_##kind(long);
VARIANTS
#undef VARIANT

/* Written by autopilot/core/seal.py when the library is built: digests of its sources and of itself. A constant, so that
 * `strip` keeps it. */
EXPORT extern const char library_seal[];
const char library_seal[26 + 2 * 32 + 1] = "autopilot library, seal 2:";

enum { plain, wide };

static int kind_of_processor(void) {
#if defined(WIDE)
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? wide : plain;
#else
    return plain;
#endif
}

LAYOUT(Task, n, thrusters, slack_l1, slack_l2, coefficients, allocation, step_s, steps, scale, x_guess, u_guess, x_ref, u_ref,
       current, weight_x, weight_u, terminal, limits, thrust_limit, plane_n, plane_d, x, u, slack, figures, work)

/* Of `work`; 0 for a number of thrusters that this is not made for. */
EXPORT long workspace_bytes(long n, long thrusters) {
    const int kind_here = kind_of_processor();
#define VARIANT(count, kind) \
    if (thrusters == count && kind_here == kind) return workspace_bytes_##count##_##kind(n);
    VARIANTS
#undef VARIANT
    return 0;
}

EXPORT void control_step(const Task *task) {
    const int kind_here = kind_of_processor();
#define VARIANT(count, kind) \
    if (task->thrusters == count && kind_here == kind) control_step_##count##_##kind(task);
    VARIANTS
#undef VARIANT
}
