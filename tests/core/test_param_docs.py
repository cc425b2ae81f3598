"""Parameters that docs/parameters.md gives one row for several."""

from autopilot.core.params import PARAMETERS


def test_numbered_parameters_that_share_a_row_differ_in_nothing_else() -> None:
    for family in ("BTN", "THR"):
        numbered = [spec for spec in PARAMETERS if spec.name.startswith(family) and spec.name[3].isdigit()]
        assert len(numbered) > 1
        assert len({(spec.default, spec.minimum, spec.maximum, spec.unit) for spec in numbered}) == 1
