"""Script of bed bath: that of scratch."""

from assistax_envs.tasks.chain import Script
from assistax_envs.tasks.scratch.script import go

SCRIPT = Script(go)
