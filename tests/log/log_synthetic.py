"""A synthetic run of the paper's mission: kinematics only, made to order for tests of the log."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import (
    AidState,
    AidStatus,
    Authority,
    ControlOutput,
    EnergyPlan,
    EstimatorInputs,
    Event,
    Fallback,
    FlightControllerState,
    Goal,
    Inputs,
    LoopStats,
    MarkerFit,
    MavlinkFrame,
    MissionProgress,
    ModeState,
    NavCounters,
    NavHealth,
    NavState,
    NmpcStatus,
    Outputs,
    ProcessStats,
    ProgressState,
    ShadowStatus,
    SolveStatus,
    ThrusterCommand,
    ThrusterHealthState,
    VelocityGoal,
)
from autopilot.core.payload import PayloadState
from autopilot.core.samples import (
    AhrsSample,
    AltimeterSample,
    CameraFrame,
    CameraTiltSample,
    DepthSample,
    ExternalPoseSample,
    GpsSample,
    HullSample,
    ImuSample,
    LaserSample,
    LeakSample,
    MarkerSighting,
    ObstacleTrack,
    PilotSample,
    PlanarFixSample,
    PoseSample,
    PowerSample,
    VelocitySample,
)
from autopilot.core.stills import StillRecord, StoredStill
from autopilot.log.description import AcceptBounds, CameraView, FenceItemDescription, Obstacle, RunDescription, Waypoint
from autopilot.log.log_session import RunLog, open_run_log

EPOCH_NS = 1_700_000_000_000_000_000
STEP_US = 50_000
LEG_S = 18.0
VIA = np.array([[-1.60, -0.35, 0.45], [-0.625, 0.30, 0.42], [0.2, 0.55, 0.38], [0.9375, 0.70, 0.34], [1.75, 0.0, 0.30]])
"""A path from A to B that keeps 0.46 m from both cylinders and 0.3 m from the walls."""
TANK = ((-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5))
PROCESS = ProcessStats(
    rss_bytes=220_000_000,
    log_queue=12,
    log_queue_bytes=9_000,
    threads=7,
    collect_s=0.002,
    thread_cpu_s=(0.2, 0.07, *[0.0] * 8, 0.03),
)

DESCRIPTION = RunDescription(
    scenario="paper-tank",
    vehicle="lbv150",
    seed=1,
    speed=0.0,
    hotel_power_w=12.0,
    tank_polygon_m=TANK,
    tank_depth_m=1.5,
    obstacles=(
        Obstacle(center_m=(-0.625, -0.625), radius_m=0.16, name="cylinder 1"),
        Obstacle(center_m=(0.9375, 0.0), radius_m=0.16, name="cylinder 2"),
    ),
    fence=(
        FenceItemDescription(inclusion=True, vertices_m=TANK),
        FenceItemDescription(inclusion=False, center_m=(-0.625, -0.625), radius_m=0.16),
        FenceItemDescription(inclusion=False, center_m=(0.9375, 0.0), radius_m=0.16),
    ),
    waypoints=(
        Waypoint(name="A", pos_ned_m=(-1.60, -0.35, 0.45), yaw_rad=0.0),
        Waypoint(name="B", pos_ned_m=(1.75, 0.0, 0.30), yaw_rad=math.pi),
    ),
    accept=AcceptBounds(laps=3),
    mode_names={"1": "mission"},
    parameters={"MPC_MARGIN": 0.05, "MPC_Q_POS": 20.0},
    camera=CameraView(
        width_px=64,
        height_px=48,
        focal_px=(80.0, 81.0),
        center_px=(31.0, 23.5),
        distortion=(0.1, 0.0, 0.0, 0.0, 0.0),
        fisheye=False,
        position_frd_m=(0.1, 0.0, 0.05),
        r_frd_from_cam=(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    ),
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Truth:
    """As the simulator gives it."""

    pos_ned_m: FloatArray
    rpy_rad: FloatArray
    vel_frd_m_s: FloatArray
    vel_water_frd_m_s: FloatArray
    rate_frd_rad_s: FloatArray
    current_ned_m_s: FloatArray
    thrust_n: FloatArray
    power_w: float


def smooth(fraction: float) -> tuple[float, float]:
    """A blend 0..1 without speed at its ends, and its slope."""
    return fraction * fraction * (3.0 - 2.0 * fraction), 6.0 * fraction * (1.0 - fraction)


def pose(t_s: float) -> tuple[FloatArray, float]:
    """Position (3,) and yaw at a time: to and fro along VIA, one way per LEG_S."""
    leg, fraction = divmod(t_s / LEG_S, 1.0)
    blend = smooth(fraction)[0]
    if int(leg) % 2:
        blend = 1.0 - blend
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(VIA, axis=0), axis=1))]
    at = blend * lengths[-1]
    position = np.array([np.interp(at, lengths, VIA[:, i]) for i in range(3)])
    return position, wrap_pi(math.pi * blend)


def truth_at(t_s: float) -> Truth:
    """The simulated vehicle on its synthetic path."""
    position, yaw = pose(t_s)
    before, yaw_before = pose(max(t_s - 0.05, 0.0))
    after, yaw_after = pose(t_s + 0.05)
    vel = (after - before) / 0.1
    c, s = math.cos(yaw), math.sin(yaw)
    body = np.array([c * vel[0] + s * vel[1], -s * vel[0] + c * vel[1], vel[2]])
    rate = wrap_pi(yaw_after - yaw_before) / 0.1
    return Truth(
        pos_ned_m=position,
        rpy_rad=np.array([0.0, 0.0, yaw]),
        vel_frd_m_s=body,
        vel_water_frd_m_s=body,
        rate_frd_rad_s=np.array([0.0, 0.0, rate]),
        current_ned_m_s=np.array([0.05, 0.0, 0.0]),
        thrust_n=np.array([3.0, 3.0 * math.cos(t_s), -1.0, 0.5]),
        power_w=20.0,
    )


def nav_of(t_us: int, truth: Truth, error_m: float = 0.004) -> NavState:
    """An estimate a few millimetres off."""
    return NavState(
        t_us=t_us,
        health=NavHealth.GOOD,
        pos_ned_m=truth.pos_ned_m + np.array([error_m, 0.0, 0.0]) * math.sin(1e-6 * t_us),
        rpy_rad=truth.rpy_rad + np.array([0.0, 0.0, 0.002]),
        vel_frd_m_s=truth.vel_frd_m_s,
        vel_water_frd_m_s=truth.vel_water_frd_m_s,
        rate_frd_rad_s=truth.rate_frd_rad_s,
        current_ned_m_s=truth.current_ned_m_s * 0.9,
        variance=np.full(12, 2.5e-5),
        reset_count=0,
    )


def heartbeat(sequence: int) -> bytes:
    """A MAVLink 2 HEARTBEAT without a valid checksum: the log does not look at it."""
    return bytes([0xFD, 9, 0, 0, sequence & 0xFF, 1, 1, 0, 0, 0]) + bytes(9) + b"\x12\x34"


@dataclass(slots=True, kw_only=True)
class Run:
    """How a synthetic run differs from a perfect one."""

    laps: int = 3
    change_truth: Callable[[float, Truth], Truth] = lambda t_s, truth: truth
    nav_error_m: float = 0.004
    thrust_n: float = 3.0
    fallback: Fallback = Fallback.NONE
    contacts: int = 0
    with_truth: bool = True
    description: RunDescription = DESCRIPTION
    step_us: int = STEP_US
    full_inputs: bool = False
    attachments: Mapping[str, bytes] = field(default_factory=dict)


def write_run(path: Path, run: Run | None = None, epoch_ns: int = EPOCH_NS) -> Path:
    """Write a whole synthetic run and return its path."""
    run = run or Run()
    log = open_run_log(
        path,
        epoch_ns=epoch_ns,
        description=run.description,
        metadata={
            "version": "0.1.0",
            "revision": "abc",
            "speed": "0",
            "scenario": run.description.scenario,
            "seed": str(run.description.seed),
        },
        attachments={"config.toml": b"[a]\nb = 1\n", **run.attachments},
        lossless=True,
    )
    end_us = int(2 * run.laps * LEG_S * 1e6) + 500_000
    for t_us in range(0, end_us + 1, run.step_us):
        _tick(log, run, t_us, end_us)
    log.close()
    return path


def _tick(log: RunLog, run: Run, t_us: int, end_us: int) -> None:
    t_s = t_us * 1e-6
    truth = run.change_truth(t_s, truth_at(t_s))
    if run.with_truth:
        log.truth(t_us, truth)
        log.contact(t_us, run.contacts if t_s > 20.0 else 0, 0.01 if 20.0 < t_s < 20.5 and run.contacts else 0.0)
    if run.full_inputs:
        log.camera(CameraFrame(t_us=t_us - 60_000, image_bgr=np.full((48, 64, 3), t_us // 100_000 % 200, np.uint8)))
    log.inputs(inputs_at(t_us, truth, run.full_inputs))
    log.outputs(outputs_at(t_us, truth, run, t_us >= end_us - 400_000))
    if run.full_inputs and t_us % 5_000_000 == 0:
        log.still(t_us, b"png")
        log.payload_truth(t_us, (0.0, 1.0))
    if t_us % 1_000_000 == 0:
        log.loop(loop_at(t_us, log.writer.dropped))


def loop_at(t_us: int, dropped: int = 0, process: ProcessStats = PROCESS) -> LoopStats:
    """A loop without troubles."""
    return LoopStats(
        t_us=t_us,
        tick_s=0.004,
        cpu_s=0.3,
        overruns=0,
        dropped_log=dropped,
        ticks_s=(0.002,) * 98 + (0.004,) * 2,
        ticks_cpu_s=(0.001,) * 98 + (0.003,) * 2,
        process=process,
    )


def inputs_at(t_us: int, truth: Truth, full: bool = True) -> Inputs:
    """One sample of each kind."""
    ahrs = AhrsSample(
        t_us=t_us - 15_000,
        rpy_rad=truth.rpy_rad,
        rate_frd_rad_s=truth.rate_frd_rad_s,
        accel_frd_m_s2=np.array([0.0, 0.0, -9.81]),
    )
    if not full:
        return Inputs(t_us=t_us, samples=(ahrs,))
    sighting = MarkerSighting(
        t_us=t_us - 60_000,
        ids=(3, 7, 3),
        corners_px=np.arange(24.0).reshape(3, 4, 2),
        laser_px=np.array([320.5, 240.25]),
        decode_us=3000,
    )
    fix = PoseSample(
        t_us=t_us - 60_000,
        pos_ned_m=truth.pos_ned_m,
        yaw_rad=float(truth.rpy_rad[2]),
        sigma_pos_m=np.array([0.003, 0.003, 0.004]),
        sigma_yaw_rad=0.0026,
    )
    laser = LaserSample(t_us=t_us - 60_000, range_m=1.1, sigma_m=0.005)
    track = ObstacleTrack(
        t_us=t_us - 100_000, track_id=3, pos_ned_m=np.array([1.0, 2.0]), vel_ned_m_s=np.array([0.1, 0.0]), radius_m=0.2
    )
    power = PowerSample(t_us=t_us, voltage_v=18.9, current_a=2.5, energy_used_j=t_us * 3e-5, remaining=0.99)
    frame = MavlinkFrame(link=0, data=heartbeat(t_us // 1_000_000))
    depth = DepthSample(t_us=t_us, depth_m=0.5, sigma_m=0.003)
    altimeter = AltimeterSample(t_us=t_us, range_m=1.2, sigma_m=0.01, confidence=0.9)
    velocity = VelocitySample(t_us=t_us, vel_frd_m_s=np.zeros(3), sigma_m_s=np.full(3, 0.01))
    external = ExternalPoseSample(t_us=t_us, pos_m=np.zeros(3), yaw_rad=0.1, covariance=None)
    imu = ImuSample(t_us=t_us, rate_frd_rad_s=truth.rate_frd_rad_s, accel_frd_m_s2=np.array([0.0, 0.0, -9.81]))
    hull = (
        LeakSample(t_us=t_us, wet=False),
        HullSample(t_us=t_us, pressure_pa=98_000.0, temperature_c=None),
        PilotSample(t_us=t_us),
        CameraTiltSample(t_us=t_us, angle_rad=-0.5),
        GpsSample(t_us=t_us, lat_deg=37.9, lon_deg=23.7, alt_m=0.2, sigma_m=1.5),
    )
    return Inputs(
        t_us=t_us,
        samples=(ahrs, imu, sighting, fix, laser, depth, altimeter, velocity, external, track, power, *hull),
        mavlink_rx=(frame,),
        overruns=2,
        cpu_load=0.25,
        below=FlightControllerState(
            t_us=t_us,
            authority=Authority.PILOT,
            acts=False,
            text="ALT_HOLD",
            refusals=("pilot has it", "switch it to MANUAL"),
            pulses_us=(1500, 1600, 1400, 1500),
        ),
    )


def outputs_at(t_us: int, truth: Truth, run: Run, done: bool = False) -> Outputs:
    """What the service would have decided."""
    thrust = np.array([run.thrust_n, run.thrust_n, -1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    status = NmpcStatus(
        t_us=t_us,
        status=SolveStatus.OK,
        fallback=run.fallback if 10_000_000 < t_us < 11_000_000 else Fallback.NONE,
        iterations=1,
        solve_s=0.001 + 1e-4 * math.sin(t_us),
        cost=12.5,
        slack_max=0.0,
        margin_m=0.05,
    )
    horizon = truth.pos_ned_m + np.linspace(0.0, 1.0, 5)[:, None] * truth.vel_frd_m_s
    control = ControlOutput(
        thrust_n=thrust[:4],
        status=status,
        horizon_ned_m=horizon,
        route_ned_m=VIA[:, :2],
        tube_m=np.linspace(0.02, 0.06, 5),
        plan=EnergyPlan(seq=1, eta_s=10.5, energy_j=180.0, trajectory_s=10.5, late=0)
        if t_us % 1_000_000 == 0
        else None,
    )
    aid = AidStatus(
        t_us=t_us,
        sensor="markers",
        innovation=np.array([0.001, -0.002, 0.0]),
        innovation_var=np.full(3, 1e-5),
        test_ratio=0.3,
        fused=True,
        state=AidState.ACTIVE,
        age_s=0.06,
        fit=MarkerFit(known=12, used=12, rms_px=0.15, worst_px=0.6),
    )
    lap, leg = int(t_us * 1e-6 / (2 * LEG_S)), int(t_us * 1e-6 / LEG_S)
    goal = Goal(
        pos_ned_m=VIA[0 if leg % 2 else -1],
        yaw_rad=None,
        speed_m_s=0.4,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=1 + leg % 2,
        drive=VelocityGoal(north_m_s=0.1, down_m_s=0.02) if run.full_inputs and 3_000_000 < t_us <= 6_000_000 else None,
    )
    state = ProgressState.COMPLETE if done else ProgressState.ACTIVE
    return Outputs(
        t_us=t_us,
        command=ThrusterCommand(t_us=t_us, thrust_n=thrust, pwm_us=(1550, 1551, 1490, 1505)),
        nav=nav_of(t_us, truth, run.nav_error_m),
        mode=ModeState(t_us=t_us, armed=True, custom_mode=1, failsafes=0),
        mavlink_tx=(MavlinkFrame(link=-1, data=heartbeat(t_us // 1_000_000)),) if t_us % 1_000_000 == 0 else (),
        estimated_from=EstimatorInputs(
            thrust_n=thrust[:4],
            samples=(
                ExternalPoseSample(t_us=t_us, pos_m=np.zeros(3), yaw_rad=0.1, covariance=None),
                PlanarFixSample(t_us=t_us, pos_ned_m=np.zeros(2), sigma_m=1.5),
            ),
        ),
        counters=NavCounters(t_us=t_us, counts={"markers.fused": 7}) if t_us % 1_000_000 == 0 else None,
        shadow=ShadowStatus(
            t_us=t_us,
            pos_difference_ned_m=np.array([0.001, 0.0, -0.002]),
            yaw_difference_rad=0.01,
            vel_difference_frd_m_s=np.zeros(3),
            ratio=0.1,
            disagrees=False,
        ),
        aids=(aid,) if t_us % 100_000 == 0 else (),
        goal=goal,
        control=control,
        thrusters=ThrusterHealthState(
            t_us=t_us, effectiveness=np.ones(4), estimate=np.full(4, 0.98), sigma=np.full(4, 0.05)
        )
        if t_us % 1_000_000 == 0
        else None,
        progress=MissionProgress(t_us=t_us, current_seq=1, reached_seq=-1, lap=lap, state=state),
        parameters={"MPC_Q_POS": 25.0} if t_us == 12_000_000 else {},
        events=(Event(t_us=t_us, severity=6, text=f"lap {lap}"),) if t_us % 5_000_000 == 0 else (),
        payload=PayloadState(t_us=t_us, pulses_us=(1100, 1900)) if run.full_inputs else None,
        stills=(still_at(t_us, truth),) if run.full_inputs and t_us % 5_000_000 == 0 else (),
    )


def still_at(t_us: int, truth: Truth) -> StillRecord:
    """A still that was stored at once."""
    return StillRecord(
        t_us=t_us,
        still=StoredStill(index=t_us // 5_000_000, exposure_us=t_us, width_px=640, height_px=480, size=3),
        seq=-1,
        pos_ned_m=truth.pos_ned_m,
        rpy_rad=truth.rpy_rad,
        variance=np.full(6, 1e-4),
    )


def shifted(at_s: float, for_s: float, **changes: object) -> Callable[[float, Truth], Truth]:
    """Replaces fields of the truth during a time."""

    def change(t_s: float, truth: Truth) -> Truth:
        return replace(truth, **changes) if at_s <= t_s < at_s + for_s else truth  # type: ignore[arg-type]

    return change


def call(*args: object) -> tuple[int, str]:
    """Run ``autopilot log ...`` in this process as the console script does: exit code and output."""
    from autopilot.cli.main import cli, run

    runner = CliRunner()
    codes: list[int] = []
    with runner.isolation() as streams:
        codes.append(run(lambda: cli(["log", *map(str, args)], standalone_mode=False)))
        out = streams[0].getvalue().decode() + streams[1].getvalue().decode()
    return codes[0], out
