"""Draws docs/images/engine.png: what the fused engine makes of the scratch scene.

    python tools/engine_figure.py

Left, the joint-space inertia's entries: those that the kinematic trees make zero are not in the
program at all. Right, how many statements each topic takes.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from assistax_envs.models import build_model
from assistax_envs.physics.fused import collision, factorisation, inertia, kinematics
from assistax_envs.physics.fused.expressions import Block
from assistax_envs.physics.fused.forces import joint_forces
from assistax_envs.physics.fused.program import derive
from assistax_envs.physics.fused.tree import read_tree
from evaluation.plots.style import own_style

PATH = Path(__file__).parents[1] / "docs/images/engine.png"
ROBOT, HUMAN, EMPTY = "#3b6ea5", "#c8743c", "#f2f2f2"


def statements(model) -> dict[str, int]:
    """Return the number of statements that each topic adds to a substep."""
    block, tree, counts = Block(), read_tree(model), {}

    def count(topic: str, value):
        counts[topic] = len(block.statements) - sum(counts.values())
        return value

    poses = count("where links are", kinematics.link_poses(block, tree))
    motions = count("how they move", kinematics.link_motions(block, tree, poses))
    inertias = count("links' inertias", inertia.link_inertias(tree, poses))
    matrix = inertia.inertia_matrix(tree, poses, inertias, model.dof_armature)
    count("inertia matrix", matrix)
    bias = inertia.bias_forces(tree, poses, motions, inertias, model.opt.gravity)
    count("Coriolis, gravity", joint_forces(block, model, bias))
    geoms = collision.contact_geoms(model, tree, poses)
    count("who touches", [collision.gap(x) for x in collision.candidates(model, geoms)])
    factor = factorisation.factorise(matrix, tree.parents)
    torques = [block.input(f"torque[{i}]") for i in range(model.nv)]
    count("factor, solve", factorisation.solve(factor, tree.parents, torques))
    counts["sensors"] = len(derive(model).block.statements) - derive(model).after
    return counts


def draw_matrix(axes, model) -> None:
    """Draw which entries of the inertia matrix the program computes."""
    tree = read_tree(model)
    colours = np.full((model.nv, model.nv, 3), plt.matplotlib.colors.to_rgb(EMPTY))
    for i, j in factorisation.entry_order(tree.parents):
        robot = model.joint(i).name.startswith("robot")
        colours[i, j] = plt.matplotlib.colors.to_rgb(ROBOT if robot else HUMAN)
    axes.imshow(colours)
    names = [model.joint(i).name.replace("human_", "").replace("robot_", "") for i in range(16)]
    axes.set_yticks(range(model.nv), names, fontsize=7)
    axes.set_xticks([])
    entries = len(factorisation.entry_order(tree.parents))
    axes.set_title(f"inertia matrix: {entries} of {model.nv**2} entries computed", fontsize=9)
    axes.set_xticks(np.arange(-0.5, model.nv), minor=True)
    axes.set_yticks(np.arange(-0.5, model.nv), minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)


def draw_statements(axes, model) -> None:
    """Draw how many statements each topic takes."""
    counts = statements(model)
    bars = axes.barh(list(counts), list(counts.values()), color=ROBOT)
    axes.bar_label(bars, fontsize=7, padding=2)
    axes.invert_yaxis()
    axes.tick_params(labelsize=8, length=0)
    axes.set_title(f"{sum(counts.values()):,} statements a substep", fontsize=9)
    axes.spines[["top", "right", "bottom"]].set_visible(False)
    axes.set_xticks([])


@own_style()
def main() -> None:
    """Draw the picture."""
    scratch = build_model("scratch")
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    draw_matrix(left, scratch)
    draw_statements(right, scratch)
    figure.savefig(PATH, dpi=150)
    print(PATH)


if __name__ == "__main__":
    main()
