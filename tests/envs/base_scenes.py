"""The paper's task whose scene each gentle task softens."""

BASES = {
    "gentle_scratch": "scratch",
    "gentle_bath": "bed_bath",
    "gentle_lift": "arm_assist",
    "gentle_feeding": "scratch",
    "gentle_brushing": "scratch",
}
