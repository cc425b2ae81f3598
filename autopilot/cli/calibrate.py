"""``autopilot calibrate``: camera, flight, laser, extrinsics, latency, thrusters. Results are printed or written."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.calibrate_flight import flight
from autopilot.cli.click_types import Finite, OneOf
from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import EXIT_LOSS, emit_json, make_console, print_table
from autopilot.cli.shared_options import JSON_NOT_TABLES, LOG_FILE

if TYPE_CHECKING:
    from autopilot.calibrate.boards import CalibrationBoard
    from autopilot.calibrate.recorded_flight import CameraFlight


_OUT = click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="Vehicle file to write (default: print the keys)."
)
_VEHICLE = click.option("--vehicle", type=VEHICLE_NAME, help="Vehicle (shipped name or file) instead of the log's own.")
_MAP = click.option("--map", "map_file", type=click.Path(path_type=Path), help="Marker map instead of the log's own.")


def _board_options(command: Any) -> Any:
    """Options that describe the board."""
    for option in reversed(
        [
            click.option(
                "--board", "kind", type=OneOf(["charuco", "grid", "chessboard"]), default="charuco", show_default=True
            ),
            click.option(
                "--shape",
                default="9x6",
                show_default=True,
                help="Squares (or markers) across and down; of a chessboard squares, not inner corners.",
            ),
            click.option(
                "--square", "pitch_m", type=Finite(), default=0.030, show_default=True, help="Pitch of squares [m]."
            ),
            click.option(
                "--marker", "marker_m", type=Finite(), default=0.022, show_default=True, help="Side of a marker [m]."
            ),
            click.option("--dictionary", default="DICT_5X5_100", show_default=True, help="Name or file (.yml)."),
            click.option("--legacy", is_flag=True, help="ChArUco drawn by OpenCV before 4.6."),
        ]
    ):
        command = option(command)
    return command


def _board(shape: str, **spec: Any) -> "CalibrationBoard":
    from autopilot.calibrate.boards import BoardSpec, CalibrationBoard, parse_shape

    columns, rows = parse_shape(shape)
    return CalibrationBoard(BoardSpec(columns=columns, rows=rows, **spec))


@click.group()
def calibrate() -> None:
    """Calibrate camera, laser, mounting and latency (docs/calibration.md)."""


calibrate.add_command(flight)


@calibrate.command()
@_board_options
@click.argument("sheet", type=click.Path(path_type=Path, dir_okay=False))
def board(sheet: Path, **spec: Any) -> None:
    """Write SHEET (.svg): a calibration board to print at true scale."""
    from autopilot.core.disk import write_result

    if sheet.suffix.lower() != ".svg":
        raise click.UsageError(f"{sheet}: a sheet is an SVG file; name it .svg")
    made = _board(**spec)
    write_result(sheet, made.svg())
    width_m, height_m = made.spec.size_m
    click.echo(f"{sheet}: {1e3 * width_m:g} x {1e3 * height_m:g} mm; print at 100 % and measure the line below it")


@calibrate.command()
@_board_options
@click.argument("source")
@click.option("--vehicle", type=VEHICLE_NAME, default="lbv150", show_default=True, help="Vehicle whose camera it is.")
@click.option("--medium", type=OneOf(["water", "air"]), default="water", show_default=True)
@click.option("--fix-k3", is_flag=True, help="k3 = 0: for narrow lenses.")
@click.option("--views", type=click.IntRange(8, 200), default=30, show_default=True, help="Live: views to take.")
@click.option("--save", type=click.Path(path_type=Path, file_okay=False), help="Live: folder to keep the views in.")
@click.option("--plot", type=click.Path(path_type=Path, dir_okay=False), help="Picture of the residuals (PNG).")
@_OUT
@JSON_NOT_TABLES
@click.pass_context
def camera(
    ctx: click.Context,
    /,
    source: str,
    vehicle: str,
    medium: str,
    fix_k3: bool,
    views: int,
    save: Path | None,
    plot: Path | None,
    out: Path | None,
    as_json: bool,
    **spec: Any,
) -> None:
    """Intrinsics from SOURCE: a folder of images of a board, a camera (/dev/video0) or a film. Exit 3 with remarks."""
    from autopilot.calibrate.intrinsics import NAMES, calibrate, camera_values, coverage, remarks
    from autopilot.calibrate.views import collect_views, image_files, is_image, live_images, read_images
    from autopilot.core.extras import need_analysis
    from autopilot.core.vehicle import load_vehicle

    if plot is not None:
        need_analysis()
    expected = load_vehicle(vehicle).eye
    made = _board(**spec)
    path = Path(source)
    live = source.startswith("/dev/") or (path.is_file() and not is_image(path))
    images = live_images(made, source, views, save) if live else read_images(image_files(path, ", or a film of it"))
    result = calibrate(collect_views(made, images, source), fix_k3=fix_k3)
    spread = coverage(result)
    warnings = remarks(result, spread, expected, medium)
    into_water = medium == "air" and expected.model != "flat_port"
    values = camera_values(result, into_water=into_water)
    if plot is not None:
        from autopilot.calibrate.intrinsics_plot import write_plot

        write_plot(result, spread, plot)
    facts = {
        "views": len(result.views),
        "left_out": dict(result.left_out),
        "rms_px": result.rms_px,
        "view_rms_px": dict(zip((view.name for view in result.views), result.view_rms_px.tolist(), strict=True)),
        "values": dict(zip(NAMES, result.values.tolist(), strict=True)),
        "sigma": dict(zip(NAMES, result.sigma.tolist(), strict=True)),
        "coverage": spread.coverage,
        "remarks": warnings,
        "keys": values,
    }
    if as_json:
        emit_json(facts)
    else:
        rows = [
            (name, f"{value:.5g}", f"{sigma:.2g}")
            for name, value, sigma in zip(NAMES, result.values.tolist(), result.sigma.tolist(), strict=True)
        ]
        across, down = result.field_of_view_deg
        print_table(
            f"{source}: {len(result.views)} views, {len(result.left_out)} left out, rms {result.rms_px:.3f} px,"
            f" view {across:.1f} x {down:.1f} deg in {medium}, corners in {spread.coverage:.0%} of the image",
            ("", "value", "sigma"),
            rows,
        )
        shown = zip(result.views, result.view_rms_px.tolist(), spread.tilt_rad.tolist(), strict=True)
        print_table(
            "Views",
            ("image", "corners", "rms px", "tilt deg"),
            [(v.name, str(len(v.pixels)), f"{rms:.3f}", f"{math.degrees(tilt):.0f}") for v, rms, tilt in shown],
        )
        for name, why in result.left_out:
            click.echo(f"left out: {name}: {why}")
        for remark in warnings:
            click.echo(f"remark: {remark}")
    origin = f"autopilot calibrate camera: {len(result.views)} views in {medium}, rms {result.rms_px:.2f} px"
    _keep(values, origin, vehicle, out, as_json)
    ctx.exit(EXIT_LOSS if warnings else 0)


@calibrate.command()
@LOG_FILE
@_VEHICLE
@_MAP
@_OUT
@JSON_NOT_TABLES
def latency(log_file: Path, vehicle: str | None, map_file: Path | None, out: Path | None, as_json: bool) -> None:
    """How late pictures are stamped, from how camera and gyros saw the vehicle turn."""
    from autopilot.calibrate.motion_fit import fit_motion, latency_values
    from autopilot.calibrate.recorded_flight import read_flight

    flight = read_flight(log_file, vehicle, map_file)
    fit = fit_motion(flight)
    values = latency_values(flight, fit)
    offset_s = values["camera.time_offset_s"]
    total_s = flight.vehicle.eye.latency_s + fit.late_s
    if as_json:
        emit_json({"late_s": fit.late_s, "sigma_s": fit.sigma_late_s, "latency_s": total_s, "keys": values})
    else:
        peak = fit.correlation[:, 1].max()
        rows = [
            ("stamps of pictures late by", f"{1e3 * fit.late_s:.2f}", f"{1e3 * fit.sigma_late_s:.2f}", "ms"),
            ("camera.time_offset_s", f"{1e3 * offset_s:.2f}", f"{1e3 * fit.sigma_late_s:.2f}", "ms"),
            ("exposure to arrival, if stamped by it", f"{1e3 * total_s:.2f}", f"{1e3 * fit.sigma_late_s:.2f}", "ms"),
            ("correlation of the yaw rates", f"{peak:.4f}", "", ""),
        ]
        print_table(_title(log_file, flight), ("", "value", "sigma", "unit"), rows)
    _keep(values, f"autopilot calibrate latency: {log_file.name}", vehicle or flight.vehicle.name, out, as_json)


@calibrate.command()
@LOG_FILE
@_VEHICLE
@_MAP
@_OUT
@JSON_NOT_TABLES
def extrinsics(log_file: Path, vehicle: str | None, map_file: Path | None, out: Path | None, as_json: bool) -> None:
    """Rotation of the camera against the AHRS, and its lever arm where the flight shows it."""
    from autopilot.calibrate.extrinsics import check_attitude, extrinsic_values, fit_lever_arm, mounting_rpy_rad
    from autopilot.calibrate.motion_fit import degrees, fit_motion
    from autopilot.calibrate.recorded_flight import read_flight

    flight = read_flight(log_file, vehicle, map_file)
    fit = fit_motion(flight)
    attitude, arm = check_attitude(flight, fit), fit_lever_arm(flight, fit)
    values = extrinsic_values(flight, fit, arm)
    mounting = degrees(mounting_rpy_rad(fit.r_frd_from_cam))
    sigma = degrees(fit.sigma_mounting_rad)
    facts = {
        "mounting_deg": mounting,
        "mounting_sigma_deg": sigma,
        "position_frd_m": None if arm is None else flight_place(flight, arm),
        "position_sigma_m": None if arm is None else arm.sigma_m.tolist(),
        "gyro_bias_rad_s": fit.gyro_bias_rad_s.tolist(),
        "late_s": fit.late_s,
        "attitude_mean_deg": degrees(attitude.mean_rad),
        "attitude_spread_deg": degrees(attitude.spread_rad),
        "keys": values,
    }
    if as_json:
        emit_json(facts)
    else:
        rows = [
            (f"mounting {name}", f"{value:.3f}", f"{s:.3f}", "deg", "")
            for name, value, s in zip(("roll", "pitch", "yaw"), mounting, sigma, strict=True)
        ]
        if arm is not None:
            place = flight_place(flight, arm)
            for name, value, s, seen in zip("xyz", place, arm.sigma_m.tolist(), arm.observable.tolist(), strict=True):
                note = "" if seen else "not observable in this flight: kept as it was"
                rows.append((f"camera {name} (frd)", f"{1e3 * value:.1f}", f"{1e3 * s:.1f}", "mm", note))
        print_table(_title(log_file, flight), ("", "value", "sigma", "unit", ""), rows)
        residual = degrees(fit.residual_rad.std(axis=0))
        turned = degrees(fit.turned_rad.std(axis=0))
        table = [
            (name, f"{a:.3f}", f"{b:.3f}", f"{c:.2f}", f"{d:.2f}", f"{e:.2f}")
            for name, a, b, c, d, e in zip(
                ("roll", "pitch", "yaw"), turned, residual, degrees(attitude.mean_rad), degrees(attitude.spread_rad),
                degrees(attitude.sigma_mean_rad), strict=True,
            )
        ]  # fmt: skip
        print_table(
            "Residuals [deg]: turns between pictures; AHRS minus camera attitude (yaw: heading offset of the AHRS)",
            ("axis", "turned rms", "residual rms", "AHRS - camera", "spread", "sigma of mean"),
            table,
        )
    _keep(values, f"autopilot calibrate extrinsics: {log_file.name}", vehicle or flight.vehicle.name, out, as_json)


@calibrate.command()
@click.argument("source", metavar="SOURCE", type=click.Path(path_type=Path))
@_board_options
@_VEHICLE
@_MAP
@_OUT
@JSON_NOT_TABLES
def laser(
    source: Path,
    vehicle: str | None,
    map_file: Path | None,
    out: Path | None,
    as_json: bool,
    **spec: Any,
) -> None:
    """Offset and direction of the beam from SOURCE: a log, or a folder of pictures of a board with the dot on it.

    Uses the pictures of the log (dots anywhere), or the dots that the flight found if they are more.
    """
    from autopilot.calibrate.laser_dots import board_dots, log_dots
    from autopilot.calibrate.laser_fit import beam_values, fit_beam
    from autopilot.calibrate.recorded_flight import read_flight
    from autopilot.calibrate.views import is_image
    from autopilot.core.camera import CameraModel
    from autopilot.core.vehicle import load_vehicle

    if source.is_dir() or is_image(source):
        known = load_vehicle(vehicle or "lbv150")
        model = CameraModel.of_vehicle(known)
        dots = board_dots(_board(**spec), model, source)
        title = f"{source}: {dots.pictures} pictures with green dots"
    else:
        flight = read_flight(source, vehicle, map_file)
        known, model = flight.vehicle, flight.camera
        dots = log_dots(source, flight)
        title = _title(source, flight)
    beam = fit_beam(dots, model)
    values = beam_values(beam, model, known)
    facts = {
        "slope_cam": beam.slope.tolist(),
        "slope_sigma": beam.sigma_slope.tolist(),
        "base_cam_m": beam.base_m.tolist(),
        "base_sigma_m": beam.sigma_base_m.tolist(),
        "rms_px": beam.rms_px,
        "used": beam.used,
        "dots": beam.dots,
        "depth_m": beam.depth_m,
        "keys": values,
    }
    if as_json:
        emit_json(facts)
    else:
        rows = []
        for axis, slope, s, base, b in zip(
            "xy", beam.slope.tolist(), beam.sigma_slope.tolist(), beam.base_m.tolist(), beam.sigma_base_m.tolist(),
            strict=True,
        ):  # fmt: skip
            rows.append(
                (
                    f"angle towards image {axis}",
                    f"{math.degrees(math.atan(slope)):.3f}",
                    f"{math.degrees(s):.3f}",
                    "deg",
                )
            )
            rows.append((f"offset along image {axis}", f"{1e3 * base:.2f}", f"{1e3 * b:.2f}", "mm"))
        left_mm = {depth_m: 1e3 * beam.sigma_range_m(depth_m) for depth_m in (0.4, 0.8, 1.2)}
        rows += [(f"range error left at {depth_m:g} m", "", f"{left:.2f}", "mm") for depth_m, left in left_mm.items()]
        print_table(
            f"{title}; {beam.used} of {beam.dots} dots on the beam, {beam.depth_m[0]:.2f} to {beam.depth_m[1]:.2f} m,"
            f" rms {beam.rms_px:.2f} px",
            ("", "value", "sigma", "unit"),
            rows,
        )
    _keep(values, f"autopilot calibrate laser: {source.name}", vehicle or known.name, out, as_json)


@calibrate.command()
@click.argument("table", metavar="TABLE", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--vehicle", type=VEHICLE_NAME, default="lbv150", show_default=True, help="Vehicle whose drive it is.")
@click.option("--thruster", help="Which one, if the table holds several.")
@_OUT
@JSON_NOT_TABLES
def thrusters(table: Path, vehicle: str, thruster: str | None, out: Path | None, as_json: bool) -> None:
    """The thrust curve of the drive from a load cell's TABLE (CSV: pulse_us, thrust_n, supply_v)."""
    from autopilot.calibrate.thrust_curve import curves_text, fit_brushed, fit_curves, read_table
    from autopilot.calibrate.vehicle_edit import write_curves
    from autopilot.core.vehicle import load_vehicle

    drive = load_vehicle(vehicle).drive
    readings = read_table(table, thruster)
    origin = f"autopilot calibrate thrusters: {table.name}, {len(readings)} readings"
    if drive.kind == "brushed":
        fit = fit_brushed(readings, drive, str(table))
        values: dict[str, Any] = {
            "drive.deadband_duty": fit.deadband_duty,
            "drive.forward_n_v2": fit.forward_n_v2,
            "drive.reverse_n_v2": fit.reverse_n_v2,
        }
        if as_json:
            emit_json({"readings": len(readings), "rms_n": fit.rms_n, "keys": values})
        else:
            rows = [(name, f"{value:.5g}") for name, value in values.items()]
            print_table(f"{table}: {len(readings)} readings, rms {fit.rms_n:.2f} N", ("", "value"), rows)
        _keep(values, origin, vehicle, out, as_json)
        return
    found = fit_curves(readings, drive, str(table))
    if as_json:
        curves = [{"supply_v": c.supply_v, "pulse_us": c.pulse_us, "thrust_n": c.thrust_n} for c in found.curves]
        emit_json({"readings": len(readings), "rms_n": found.rms_n, "curves": curves})
    else:
        click.echo(f"{table}: {len(readings)} readings, {len(found.curves)} supply voltages, rms {found.rms_n:.2f} N")
    if out is not None:
        write_curves(vehicle, curves_text(found.curves), origin, out)
    elif not as_json:
        click.echo(curves_text(found.curves))


def flight_place(flight: "CameraFlight", arm: Any) -> list[float]:
    """Camera in the body frame."""
    return [a + b for a, b in zip(arm.arm_frd_m.tolist(), flight.vehicle.ahrs.position_frd_m, strict=True)]


def _title(log_file: Path, flight: "CameraFlight") -> str:
    return (
        f"{log_file}: {len(flight.t_s)} of {flight.sightings} sightings, {flight.t_s[-1] - flight.t_s[0]:.0f} s,"
        f" corners {float(sorted(flight.rms_px)[len(flight.rms_px) // 2]):.2f} px"
    )


def _keep(values: Mapping[str, Any], origin: str, vehicle: str, out: Path | None, quiet: bool) -> None:
    """Write a copy of the vehicle file with the new values, or print them."""
    from autopilot.calibrate.vehicle_edit import snippet, write_updated

    if out is not None:
        write_updated(vehicle, values, origin, out)
        if not quiet:
            click.echo(f"{out}: {vehicle} with {', '.join(values)}")
    elif not quiet:
        make_console().print(snippet(values), markup=False, highlight=False)
