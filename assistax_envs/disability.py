"""Disability settings d1..d9 of the human (paper, 3.1 and Table 6). Imports no JAX or MuJoCo."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Disability:
    """Impairment of the human's right arm."""

    strength: float = 1.0  # share of the human's joint torques that is left, in (0, 1]
    elbow_range: float = (
        1.0  # share of the elbow's range about its rest angle that is left, in (0, 1]
    )
    tremor: float = (
        0.0  # standard deviation of the tremor torque, as a share of the joint's torque limit
    )

    def __post_init__(self) -> None:
        for name in ("strength", "elbow_range"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}; allowed is a share in (0, 1]")
        if not 0.0 <= self.tremor <= 1.0:
            raise ValueError(f"tremor is {self.tremor}; allowed is a share in [0, 1]")


_LEVELS = (1.0, 0.7, 0.4)

# Strength runs fastest: d2 is a full range at strength 0.7, d4 a range of 0.7 at full strength.
DISABILITY_SETTINGS: dict[str, Disability] = {
    f"d{1 + 3 * i + j}": Disability(strength=strength, elbow_range=elbow_range)
    for i, elbow_range in enumerate(_LEVELS)
    for j, strength in enumerate(_LEVELS)
}
