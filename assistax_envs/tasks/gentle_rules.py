"""Limits of forces on the parts of a human in the gentle tasks."""

from collections.abc import Mapping

from assistax_envs.models.care_scenes import FACE, TEETH

# N, of one contact, by part of the human: what healthy adults bear in a quasi-static contact before
# it hurts (ISO/TS 15066:2016, Table A.2; the trunk has the abdomen's, which is less than the
# chest's). Most of them are preliminary: Behrens et al. 2022 (doi 10.3389/frobt.2021.667818) and
# Han et al. 2022 (doi 10.3390/s22082996) measured such thresholds.
BEARABLE: dict[str, float] = {
    "human_head": 65.0,
    "human_torso": 110.0,
    "human_upper_waist": 110.0,
    "human_lower_waist": 110.0,
    "human_right_upper_arm": 150.0,
    "human_right_lower_arm": 160.0,
    "human_right_hand": 140.0,
    "right_thigh": 220.0,
    "left_thigh": 220.0,
    # No standard has lips, chin, throat and teeth: the face's.
    **dict.fromkeys((*FACE[1:], *(f"human_{part}" for part in TEETH)), 65.0),
}
# The people here are frail. Limits of frail people have not been measured: half is a choice.
FRAIL = 0.5
# N, of one contact with a part in any physics step. Half a second above it, added up over the
# episode, is a violation, which ends the episode as a protective stop does.
LIMITS: Mapping[str, float] = {part: FRAIL * limit for part, limit in BEARABLE.items()}
HARD = min(LIMITS.values())  # N, of one contact: the least of these limits
# N, of one contact, above which even a short one is a violation: twice the quasi-static limit, but
# no more than that at the face (ISO/TS 15066:2016, Table A.2).
AT_FACE = ("human_head", *FACE[1:], *(f"human_{part}" for part in TEETH))
IMPACT_LIMITS: Mapping[str, float] = {
    part: limit * (1.0 if part in AT_FACE else 2.0) for part, limit in LIMITS.items()
}
