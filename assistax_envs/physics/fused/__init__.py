"""A physics engine made for one model at a time: MuJoCo's equations as straight-line C++.

`generate` reads a compiled `mujoco.MjModel` and returns a `Program`: the text of one substep, in
which the kinematic tree is unrolled and all that the model fixes (masses, axes, which joint carries
which) is folded into constants, followed by a solver of MuJoCo's soft constraints that runs to
convergence. The same text runs W simulations in the lanes of a CPU's vector, or one in each thread
of a GPU. `runtime` compiles and calls it.

The contract between the text and what calls it:

    #define W 8                   // lanes; 1 on a GPU
    <Program.source>              // includes nothing; defines real, FN, LANES, lane, NV, NU,
                                  // NSENS, NPEAK, NWARM

    template <class Sensors>
    void substep(real* q, real* qd,                    // [NV] in and out
                 const real* u,                        // [NU] controls
                 const real* lo, const real* hi,       // [NV] range of every joint
                 Sensors& sensors,                     // sensors[k] = real; written if `last`
                 real* peaks,                          // [NPEAK] raised to this substep's forces
                 bool last,
                 unsigned* warm,                       // [NWARM * W]
                 Report& report);                      // counts [W] of `layout.h`

- `sensors` are those of the state before the substep, as MuJoCo's are after `mj_step`.
- `warm` must be all zeros before the first substep of a control step; later substeps find in it
  which contacts acted. It saves iterations, and so that it cannot do more, it never outlives a
  control step: what a control step returns depends on its arguments alone.
- `report` counts, for each simulation, substeps that went wrong: with more than
  `Program.max_contacts` contacts (the first ones act), and those in which the constraint forces did
  not settle. Such a simulation's state must not pass for a good one.
- Compile without contraction (`-ffp-contract=off`, `--fmad=false`) and without fast math. Then
  every operation is rounded as IEEE 754 says, and a simulation's numbers are the same for every W,
  whatever its neighbours are, on every processor; it costs a tenth to a fifth of the speed.
- The key of a compiled program is a hash of the model's bytes and of the generator's files.

Topics, in the order in which a substep needs them: `tree` (the model as constants), `kinematics`,
`inertia` (inertia matrix and bias forces), `forces` (springs, dampers, motors), `collision` (which
geoms touch), `factorisation`, `sensors`; `expressions` and `vectors` are what these are written in.
The solver is C++: `lanes.h` (arithmetic), `layout.h` (what it is given), `contact.h` (points and
frames), `rows.h` (constraint rows), `newton.h` (which of them act) and `acting.h` (their forces),
`solver.h`; `constraints` writes its tables. `checks` refuses what is not supported, and `program`
puts all together.
"""

from assistax_envs.physics.fused.checks import UnsupportedModelError
from assistax_envs.physics.fused.program import OVERFLOWED, UNSETTLED, Program, generate

__all__ = ["OVERFLOWED", "UNSETTLED", "Program", "UnsupportedModelError", "generate"]
