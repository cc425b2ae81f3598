"""Load cell tables: the drive comes back from what it would have pushed, and what cannot be is refused."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from autopilot.cli.calibrate import calibrate
from autopilot.core.thrust_law import law_of
from autopilot.core.vehicle import load_vehicle


def table(path: Path, vehicle: str, supplies: tuple[float, ...], noise_n: float, seed: int = 1, sign: int = 1) -> Path:
    """What a load cell reads of a vehicle's own drive."""
    drive = load_vehicle(vehicle).drive
    law, rng = law_of(drive), np.random.default_rng(seed)
    lines = ["pulse_us, thrust_n, supply_v"]
    for supply_v in supplies:
        for offset in range(-drive.span_us, drive.span_us + 1, 20):
            sagging_v = supply_v - 0.2 * abs(offset) / drive.span_us
            push = sign * law.thrust_n(offset, sagging_v) + noise_n * float(rng.standard_normal())
            lines.append(f"{drive.neutral_us + offset}, {push:.4f}, {sagging_v:.3f}")
    file = path / "cell.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def run(*args: object) -> str:
    result = CliRunner().invoke(calibrate, ["thrusters", *map(str, args)])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("supplies", [(19.0,), (16.0, 19.0)])
def test_a_brushed_drive_comes_back(tmp_path: Path, supplies: tuple[float, ...]) -> None:
    out = tmp_path / "mine.toml"
    run(table(tmp_path, "lbv150", supplies, 0.05), "--vehicle", "lbv150", "--out", out)
    new, old = load_vehicle(str(out)), load_vehicle("lbv150")
    assert new.drive.forward_n_v2 == pytest.approx(old.drive.forward_n_v2, rel=0.01)
    assert new.drive.reverse_n_v2 == pytest.approx(old.drive.reverse_n_v2, rel=0.01)
    assert new.drive.deadband_duty == pytest.approx(old.drive.deadband_duty, abs=0.05)
    assert "cell.csv" in new.sources["drive.forward_n_v2"]


def test_a_maker_s_curves_come_back(tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    run(table(tmp_path, "bluerov2", (12.0, 16.0), 0.1), "--vehicle", "bluerov2", "--out", out)
    new, old = load_vehicle(str(out)).drive, load_vehicle("bluerov2").drive
    assert [curve.supply_v for curve in new.curve] == pytest.approx([11.9, 15.9], abs=0.05)
    ours, theirs = law_of(new), law_of(old)
    for offset in range(-400, 401, 50):
        # 1 % of the largest thrust is taken for none; a sagging supply is made up for by its square
        assert ours.thrust_n(offset, 16.0) == pytest.approx(theirs.thrust_n(offset, 16.0), rel=0.02, abs=0.6)


@given(st.lists(st.floats(-40.0, 40.0), min_size=41, max_size=41))
def test_any_table_gives_a_curve_that_can_be_flown_or_is_refused(thrusts: list[float]) -> None:
    from autopilot.calibrate.thrust_curve import Readings, fit_curves
    from autopilot.core.errors import ConfigError

    drive = load_vehicle("bluerov2").drive
    pulses = np.linspace(1100, 1900, 41)
    try:
        fit = fit_curves(Readings(pulses, np.array(thrusts), np.full(41, 16.0)), drive, "table")
    except ConfigError as error:
        assert "table" in str(error)
        return
    (curve,) = fit.curves
    assert np.all(np.diff(curve.thrust_n) >= 0.0)
    type(drive)(**{name: getattr(drive, name) for name in drive.__struct_fields__ if name != "curve"}, curve=fit.curves)


def test_a_table_saved_by_a_spreadsheet_is_read(tmp_path: Path) -> None:
    file = table(tmp_path, "lbv150", (16.0,), 0.05)
    before = run(file)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert run(file) == before


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "has no column 'pulse_us'"),
        ("pulse_us,thrust_n\n1500,0\n", "has no column 'supply_v'"),
        ("pulse_us;thrust_n;supply_v\n1500;0;16\n", "commas between them"),
        ("pulse_us,thrust_n,supply_v\n", "0 readings are too few"),
        ("pulse_us,thrust_n,supply_v\n1500,zero,16\n", "line 2: `thrust_n` = 'zero' is not a number"),
        ("pulse_us,thrust_n,supply_v\n\n\n1500,zero,16\n", "line 4: `thrust_n` = 'zero' is not a number"),
        ("pulse_us,thrust_n,supply_v,thrust_n\n1500,0,16,0\n", "has 2 columns 'thrust_n'"),
        (
            "pulse_us,thrust_n,supply_v\n" + "1900,5,16\n1900,15,16\n1100,-5,16\n1100,-15,16\n" * 2,
            "contradict each other",
        ),
        ("pulse_us,thrust_n,supply_v\n" + "1900,5,16\n1100,-5,16\n" * 3 + "-1900,5,16\n", "contradict each other"),
        ("pulse_us,thrust_n,supply_v\n1500,0,16\n", "1 readings are too few"),
        ("pulse_us,thrust_n,supply_v\n" + "1900,5,0\n" * 6, "`supply_v` must be above 0"),
        ("pulse_us,thrust_n,supply_v\n" + "1900,5,16000\n" * 6, "`supply_v` must be above 0, at most 1000; give volts"),
        ("pulse_us,thrust_n,supply_v\n" + "1900,5,16\n" * 6, "0 readings astern of neutral push"),
        (
            "thruster,pulse_us,thrust_n,supply_v\n" + "port,1900,5,16\nstarboard,1900,5,16\n" * 6,
            "holds port, starboard; say which",
        ),
    ],
)
def test_tables_that_tell_nothing_are_refused(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "cell.csv"
    file.write_text(text)
    result = CliRunner().invoke(calibrate, ["thrusters", str(file)])
    assert result.exit_code != 0
    assert says in result.output + str(result.exception)


@pytest.mark.parametrize("vehicle", ["lbv150", "bluerov2"])
def test_a_cell_the_wrong_way_round_is_noticed(tmp_path: Path, vehicle: str) -> None:
    file = table(tmp_path, vehicle, (16.0,), 0.05, sign=-1)
    result = CliRunner().invoke(calibrate, ["thrusters", str(file), "--vehicle", vehicle])
    assert "turn the sign of `thrust_n`, or set `reversed`" in result.output + str(result.exception)
