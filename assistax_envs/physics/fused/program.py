"""Puts the topics together: the C++ text of one substep of a model."""

import dataclasses
from importlib import resources

import mujoco

from assistax_envs.physics.base import values_width
from assistax_envs.physics.fused import collision, constraints, factorisation, inertia, kinematics
from assistax_envs.physics.fused.checks import check_supported
from assistax_envs.physics.fused.expressions import Block, Scalar, literal, minimum, text
from assistax_envs.physics.fused.forces import joint_forces
from assistax_envs.physics.fused.inertia import Entries
from assistax_envs.physics.fused.sensors import sensor_values
from assistax_envs.physics.fused.tree import Tree, read_tree
from assistax_envs.versions import FUSED_VERSION

MAX_CONTACTS = 12  # at once in one simulation; more are left out and flagged
MAX_ITERATIONS = 20  # of Newton's method in a substep
MAX_SEARCHES = 20  # steps of a line search
PATIENCE = 6  # iterations; then one that changes accelerations by less than
SETTLED = 1e-4  # of what constraints do to them is the last
STUCK = 1e-3  # the same, where no share of the step lowers the cost
# A contact, in iterations of Newton's method: what makes a substep long.
EFFORT_OF_CONTACT = 4
STRETCH = 100  # statements that the warps of a GPU's block go through before they wait for the last
OVERFLOWED = 1  # added to a simulation's flags by each substep in which contacts were left out
UNSETTLED = 1 << 16  # and by each in which the constraint forces did not settle


@dataclasses.dataclass(frozen=True)
class Program:
    """The text that advances simulations of one model, and its sizes."""

    source: str
    version: int
    nq: int
    nv: int
    nu: int
    njnt: int
    nsensordata: int
    warm_words: int  # `unsigned` of each simulation that carry the solver's first guess
    max_contacts: int
    max_rows: int


@dataclasses.dataclass(frozen=True)
class Dynamics:
    """The straight-line part of a substep, as values of one block; statements by their numbers."""

    block: Block
    tree: Tree
    poses: list[kinematics.Pose]
    matrix: Entries  # joint-space inertia
    forces: list[Scalar]  # torques before constraints act
    geoms: dict[int, collision.Geom]
    places: list[collision.Candidate]
    gaps: list[Scalar]
    near: Scalar  # below 0 where any limit is passed or any geoms touch
    accelerations: list[Scalar]  # under the torques that the text calls torque[...]
    sensors: list[Scalar]
    before: int  # statements before constraints act; then follow those of the accelerations
    after: int  # and from here on those of the sensors


def generate(model: mujoco.MjModel) -> Program:
    """Generate the program of `model`.

    Raises:
        UnsupportedModelError: the model has features that the engine does not compute.
    """
    check_supported(model)
    dynamics = derive(model)
    parts = [
        _header("lanes.h"),
        _sizes(model, dynamics),
        _header("layout.h"),
        _tables(model, dynamics),
        factor_functions(dynamics.tree.parents),
        *map(_header, ("contact.h", "rows.h", "acting.h", "newton.h", "solver.h")),
        _substep(model, dynamics),
    ]
    return Program(
        source="\n".join(parts),
        version=FUSED_VERSION,
        nq=model.nq,
        nv=model.nv,
        nu=model.nu,
        njnt=model.njnt,
        nsensordata=model.nsensordata,
        warm_words=_warm_words(dynamics),
        max_contacts=MAX_CONTACTS,
        max_rows=int(model.jnt_limited.sum()) + 4 * MAX_CONTACTS,
    )


def derive(model: mujoco.MjModel) -> Dynamics:
    """Write the straight-line part of a substep of `model` into a block."""
    block, tree = Block(), read_tree(model)
    poses = kinematics.link_poses(block, tree)
    motions = kinematics.link_motions(block, tree, poses)
    inertias = inertia.link_inertias(tree, poses)
    matrix = inertia.inertia_matrix(tree, poses, inertias, model.dof_armature)
    bias = inertia.bias_forces(tree, poses, motions, inertias, model.opt.gravity)
    forces = joint_forces(block, model, bias)
    geoms = collision.contact_geoms(model, tree, poses)
    places = collision.candidates(model, geoms)
    gaps = [collision.gap(place) for place in places]
    near = _nearest(block, model, gaps)
    # The integrator `implicitfast` takes the dampers at the end of the substep: (M + h B) a = f.
    implicit = dict(matrix)
    for i in range(model.nv):
        implicit[i, i] = matrix[i, i] + float(model.opt.timestep * model.dof_damping[i])
    factor = factorisation.factorise(implicit, tree.parents)
    before = len(block.statements)
    torques = [block.input(f"torque[{i}]") for i in range(model.nv)]
    accelerations = factorisation.solve(factor, tree.parents, torques)
    after = len(block.statements)
    sensors = sensor_values(block, model, tree, poses, motions)
    return Dynamics(
        block, tree, poses, matrix, forces, geoms, places, gaps, near, accelerations, sensors,
        before, after,
    )  # fmt: skip


def _nearest(block: Block, model: mujoco.MjModel, gaps: list[Scalar]) -> Scalar:
    """Return the least of all gaps and of all distances to joint limits."""
    near: Scalar = 1.0
    for i in range(model.njnt):
        if model.jnt_limited[i]:
            angle = block.input(f"q[{i}]")
            for inside in (angle - block.input(f"lo[{i}]"), block.input(f"hi[{i}]") - angle):
                near = minimum(inside, near)
    for gap in gaps:
        near = minimum(gap, near)
    return near


def _header(name: str) -> str:
    return resources.files("assistax_envs.physics.fused").joinpath(name).read_text()


def _warm_words(dynamics: Dynamics) -> int:
    """Return the words that hold four bits, one an edge, of every candidate."""
    return max(1, -(-len(dynamics.places) // 8))


def _sizes(model: mujoco.MjModel, dynamics: Dynamics) -> str:
    limits = int(model.jnt_limited.sum())
    sizes = {
        "NV": model.nv,
        "NU": model.nu,
        "NM": len(dynamics.matrix),
        "NLIMIT": limits,
        "NGEOM": len(dynamics.geoms),
        "NCANDIDATE": len(dynamics.places),
        "NFORCE": len(constraints.force_sensors(model)),
        "NSENS": model.nsensordata,
        "NPEAK": values_width(model) - model.nsensordata,
        "NWARM": _warm_words(dynamics),
        "MAX_CONTACTS": MAX_CONTACTS,
        "MAX_ROWS": limits + 4 * MAX_CONTACTS,
        "MAX_ITERATIONS": MAX_ITERATIONS,
        "MAX_SEARCHES": MAX_SEARCHES,
        "PATIENCE": PATIENCE,
        "SETTLED": literal(SETTLED),
        "STUCK": literal(STUCK),
        "EFFORT_OF_CONTACT": EFFORT_OF_CONTACT,
        "OVERFLOWED": OVERFLOWED,
        "UNSETTLED": UNSETTLED,
        "IMPRATIO": literal(model.opt.impratio),
    }
    if any(place.end for place in dynamics.places):
        sizes["HAS_PLANE"] = 1
    return "\n".join(f"#define {name} {value}" for name, value in sizes.items())


def _tables(model: mujoco.MjModel, dynamics: Dynamics) -> str:
    geoms, places = dynamics.geoms, dynamics.places
    trees = [str(link.tree) for link in dynamics.tree.links]
    tables = {
        "LimitData LIMIT[]": constraints.limit_table(model),
        "GeomData GEOM[]": constraints.geom_table(geoms),
        "CandidateData CANDIDATE[]": constraints.candidate_table(model, geoms, places),
        "int TREE_OF[]": trees,
        "float TREE_SHIFT[][3]": constraints.tree_shifts(dynamics.tree),
    }
    return "\n".join(
        f"TABLE {name} = {{" + ",\n".join(entries or ["{}"]) + "};"
        for name, entries in tables.items()
    )


def factor_functions(parents: list[int]) -> str:
    """Return the C++ functions of the inertia's factor L, 1 / D; see `factorisation`."""
    block = Block("f")
    order = factorisation.entry_order(parents)
    place = {entry: number for number, entry in enumerate(order)}
    matrix: inertia.Entries = {e: block.input(f"in[{number}]") for e, number in place.items()}
    factor = factorisation.factorise(matrix, parents)
    below = [(i, j) for i in reversed(range(len(parents)))
             for j in reversed(factorisation.ancestors(parents, i))]  # fmt: skip
    bodies = {
        "factor_inertia(const real* in, real* out)": [
            block.source(),
            *(f"out[{number}] = {text(factor[entry])};" for entry, number in place.items()),
        ],
        "inverse_diagonal(const real* l, real* d)": [
            f"d[{i}] = l[{place[i, i]}];" for i in range(len(parents))
        ],
        "solve_transposed(const real* l, real* x)": [
            f"x[{j}] = x[{j}] - l[{place[i, j]}] * x[{i}];" for i, j in below
        ],
        "multiply_transposed(const real* l, real* x)": [
            f"x[{j}] = x[{j}] + l[{place[i, j]}] * x[{i}];" for i, j in reversed(below)
        ],
    }
    return "\n".join("\n".join([f"FN void {name} {{", *body, "}"]) for name, body in bodies.items())


def _substep(model: mujoco.MjModel, dynamics: Dynamics) -> str:
    block, h = dynamics.block, literal(model.opt.timestep)
    lines = block.source().split("\n")
    integrate = [
        f"qd[{i}] = qd[{i}] + {h} * {text(a)};\nq[{i}] = q[{i}] + {h} * qd[{i}];"
        for i, a in enumerate(dynamics.accelerations)
    ]
    return "\n".join(
        [
            "template <class Sensors>",
            "FN void substep(real* q, real* qd, const real* u, const real* lo, const real* hi,",
            "                Sensors& sensors, real* peaks, bool last, unsigned* warm,",
            "                Report& report) {",
            *_in_stretches(lines[: dynamics.before]),
            f"real torque[NV] = {{{', '.join(map(text, dynamics.forces))}}};",
            "real sensed[9 * NFORCE + 1];",
            "UNROLL for (int k = 0; k < 9 * NFORCE; ++k) sensed[k] = splat(0.0f);",
            f"mask acts = {text(dynamics.near)} < 0.0f;",
            "if (any(acts)) {",
            *_stage(dynamics),
            "solve_constraints(now, torque, sensed, peaks, warm, report);",
            "} else {",
            "for (int k = 0; k < NWARM * W; ++k) warm[k] = 0;",
            "}",
            "if (last) {",
            *lines[dynamics.after :],
            *(f"sensors[{k}] = {text(x)};" for k, x in enumerate(dynamics.sensors)),
            "}",
            *_in_stretches(lines[dynamics.before : dynamics.after]),
            *integrate,
            "}\n",
        ]
    )


def _in_stretches(lines: list[str]) -> list[str]:
    """Return straight-line statements with a place to wait before each stretch of them."""
    starts = range(0, len(lines), STRETCH)
    return [line for start in starts for line in ("TOGETHER", *lines[start : start + STRETCH])]


def _stage(dynamics: Dynamics) -> list[str]:
    """Return the statements that hand the state at hand to the solver."""
    order = factorisation.entry_order(dynamics.tree.parents)
    fields = {
        "inertia": [dynamics.matrix[entry] for entry in order],
        "force": dynamics.forces,
        "gap": dynamics.gaps,
    }
    rows = {
        "motion": [[*pose.axis, *pose.moment] for pose in dynamics.poses],
        "geom": [[*geom.position, *geom.axis] for geom in dynamics.geoms.values()],
    }
    for name, vectors in rows.items():
        for i, vector in enumerate(vectors):
            fields[f"{name}[{i}]"] = vector
    return [
        "Stage now;",
        "now.acts = acts;",
        "UNROLL for (int i = 0; i < NV; ++i) {",
        "now.q[i] = q[i]; now.qd[i] = qd[i]; now.lo[i] = lo[i]; now.hi[i] = hi[i];",
        "}",
        *(
            f"now.{name}[{i}] = {text(value)};"
            for name, values in fields.items()
            for i, value in enumerate(values)
        ),
    ]
