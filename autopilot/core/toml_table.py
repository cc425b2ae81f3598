"""What the tables of a TOML file are made of."""

from typing import Annotated, TypeAlias

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Vec2: TypeAlias = tuple[float, float]
Vec3: TypeAlias = tuple[float, float, float]
Positive3: TypeAlias = tuple[Positive, Positive, Positive]
Positive4: TypeAlias = tuple[Positive, Positive, Positive, Positive]
NonNegative3: TypeAlias = tuple[NonNegative, NonNegative, NonNegative]
NonNegative4: TypeAlias = tuple[NonNegative, NonNegative, NonNegative, NonNegative]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A TOML table: immutable, unknown keys are errors."""
