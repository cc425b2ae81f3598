"""Controllers, estimators and plants that ship. Nothing is imported: --help lists the names."""

SHIPPED_PARTS = {
    "controller": {"nmpc": "autopilot.control.controller:of_context", "los-pid": "autopilot.control.los_pid:LosPid"},
    "estimator": {
        "ekf": "autopilot.estimator.ekf:of_context",
        "complementary": "autopilot.estimator.complementary:of_context",
    },
    "plant": {"rigid-body": "autopilot.sitl.protocol:rigid_body"},
}
"""Kind -> name -> ``module:attribute`` of its factory."""
