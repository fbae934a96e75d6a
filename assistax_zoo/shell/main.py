"""The command line: its commands, and the handling of their errors.

Commands are registered by import path, so that `assistax-zoo list` never pays for JAX, MuJoCo or
matplotlib.
"""

import contextlib
import inspect
import os
import re
import sys
from collections.abc import Collection, Sequence

from cyclopts import App, CycloptsError, Group, Parameter

from assistax_base.errors import ZooError, lacks_memory, printable
from assistax_envs.drawing.gl import told_choice
from assistax_zoo.shell.console import remember_command
from assistax_zoo.shell.installed import broken_commands, installed_commands, installed_groups
from assistax_zoo.shell.interrupts import EXIT_INTERRUPT, end_now, ended_by_interrupts, interrupted
from zoo.locations import cache_root

DEBUG_VARIABLE = "ASSISTAX_ZOO_DEBUG"
EXIT_ERROR, EXIT_USAGE, EXIT_BROKEN_PIPE = 1, 2, 141
MOST_CHARACTERS = 8_000  # of an error that is printed

COMMANDS = {
    "list": "assistax_zoo.commands.partners.listing:list_policies",
    "show": "assistax_zoo.commands.partners.listing:show",
    "verify": "assistax_zoo.commands.partners.listing:verify",
    "fetch": "assistax_zoo.commands.partners.remote:fetch",
    "add": "assistax_zoo.commands.partners.remote:add",
    "remove": "assistax_zoo.commands.partners.remote:remove",
    "lock": "assistax_zoo.commands.partners.remote:lock",
    "export": "assistax_zoo.commands.partners.export:export",
    "cite": "assistax_zoo.commands.partners.cite:cite",
    "evaluate": "assistax_zoo.commands.evaluation.evaluate:evaluate",
    "crossplay": "assistax_zoo.commands.evaluation.evaluate:crossplay",
    "compare": "assistax_zoo.commands.evaluation.report:compare",
    "strategies": "assistax_zoo.commands.evaluation.report:strategies",
    "persons": "assistax_zoo.commands.evaluation.persons:persons",
    "people": "assistax_zoo.commands.evaluation.people:people",
    "report": "assistax_zoo.commands.evaluation.report:report",
    "replay": "assistax_zoo.commands.partners.provenance:replay",
    "train": "assistax_zoo.commands.training.train:train",
    "train-ego": "assistax_zoo.commands.training.train_ego:train_ego",
    "render": "assistax_zoo.commands.evaluation.render:render",
    "watch": "assistax_zoo.commands.evaluation.watch:watch",
    "play": "assistax_zoo.commands.evaluation.play:play",
    "trajectories": "assistax_zoo.commands.evaluation.render:trajectories",
    "doctor": "assistax_zoo.commands.machine:doctor",
    "cache": "assistax_zoo.commands.machine:cache",
    "split.list": "assistax_zoo.commands.partners.split:list_splits",
    "split.show": "assistax_zoo.commands.partners.split:show",
    "split.create": "assistax_zoo.commands.partners.split:create",
    "split.verify": "assistax_zoo.commands.partners.split:verify",
    "config.remote": "assistax_zoo.commands.partners.remote:config_remote",
    "plot.crossplay": "assistax_zoo.commands.evaluation.plot:crossplay",
    "plot.zsc": "assistax_zoo.commands.evaluation.plot:zsc",
    "plot.disability": "assistax_zoo.commands.evaluation.plot:disability",
    "plot.preference": "assistax_zoo.commands.evaluation.plot:preference",
    "plot.adaptation": "assistax_zoo.commands.evaluation.plot:adaptation",
    "plot.profile": "assistax_zoo.commands.evaluation.plot:profile",
    "plot.curves": "assistax_zoo.commands.evaluation.plot:curves",
    "plot.speed": "assistax_zoo.commands.evaluation.plot:speed",
    "plot.sweep": "assistax_zoo.commands.evaluation.plot:sweep",
    "plot.population": "assistax_zoo.commands.evaluation.plot:population",
    "cache.clean": "assistax_zoo.commands.machine:clean_cache",
}
GROUPS = {  # words that are no command alone
    "split": "Which partners train robots, and which test them.",
    "config": "Settings of this machine.",
    "plot": "Figures from saved tables.",
}
# Which option does what an error advises, by the `remedy` of a `ZooError` or `AdvisedError` of
# `assistax_base.errors`; libraries name no options.
REMEDIES = {
    "accept changes": "--yes accepts them",
    "fetch before": "--fetch does so in the same command",
    "name a remote": "--from names one",
    "new release": "--release v1, for example",
    "allow small": "--small does so",
    "evaluate first": "`assistax-zoo evaluate NAME --out FOLDER` does so",
    "reuse or replace": "--reuse, --replace and --out do so",
    "replace the job": "--out names another, --replace removes what it holds",
    "replace the file": "--force replaces it, --out names another",
}
# What `--help` shows together, by what somebody came for: first words of commands, ours and other
# distributions'.
AUDIENCES = {
    "Take partners": "list show fetch add remove export verify lock split cite",
    "Evaluate": "evaluate crossplay compare report plot watch play render trajectories strategies "
    "persons people replay",
    "Train": "train train-ego sweep",
    "Publish, make releases and tasks": "publish audit gates",
    "Boards": "submit submission serve worker token season receipt ledger service",
    "This machine": "doctor cache config --help --version --install-completion",
}


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 error, 2 wrong usage, 130 interrupted.

    `replay` exits with 3 where it can neither confirm nor refute a figure.

    An error is one message on standard error; ASSISTAX_ZOO_DEBUG=1 raises it instead, with its
    traceback.

    Args:
        arguments: Words of the command line after the program's name. Without them they are
            `sys.argv[1:]`, this process is the command's own, and Ctrl-C ends it.
    """
    if arguments is not None:
        code = _run(arguments)
        return _fail("interrupted", code) if code == EXIT_INTERRUPT else code
    try:
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(ended_by_interrupts())
            except (OSError, RuntimeError) as error:  # no more files, no more threads
                return _fail(_message(error), EXIT_ERROR)
            code = _run(sys.argv[1:])
            if code == EXIT_INTERRUPT:
                end_now()
            return code
    except KeyboardInterrupt:  # in the midst of telling an error, or on the way out
        end_now()


def _run(arguments: Sequence[str]) -> int:
    _use_compilation_cache()
    try:
        _check_stdout()
        broken = broken_commands(arguments, COMMANDS, GROUPS)
        app = build_app(leave_out=broken)
        _add_subcommands(app, arguments, leave_out=broken)
        _complete_help(app, arguments, [*map(str, broken.values())])
        remember_command(arguments)
        app(arguments, print_error=False, exit_on_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return _fail(
            f"{error}\ntry: {' '.join(('assistax-zoo', *(error.command_chain or ())))} --help",
            EXIT_USAGE,
        )
    except KeyboardInterrupt:
        return EXIT_INTERRUPT
    except BrokenPipeError:
        _silence_stdout()
        return EXIT_BROKEN_PIPE
    except Exception as error:
        if interrupted():
            return EXIT_INTERRUPT
        if os.environ.get(DEBUG_VARIABLE):
            raise
        return _fail(_message(error), EXIT_ERROR)
    return 0


def all_commands(leave_out: Collection[str] = ()) -> dict[str, str]:
    """Return the import path of each command: "list", "split.create", "train.population".

    Args:
        leave_out: Commands of other distributions that are left out.
    """
    installed = installed_commands(COMMANDS)
    return COMMANDS | {name: path for name, path in installed.items() if name not in leave_out}


def all_groups() -> dict[str, str]:
    """Return the text of each word that is no command alone."""
    return {**GROUPS, **installed_groups(GROUPS)}


def build_app(leave_out: Collection[str] = ()) -> App:
    """Return the app, with every command registered and not yet imported.

    Args:
        leave_out: Commands of other distributions that are left out.
    """
    app = App(
        name="assistax-zoo",
        help="Pretrained partners for assistive robots, and the evaluation of robots against them.",
        version=_version,
        default_parameter=Parameter(negative_iterable=()),  # no --empty-author beside --author
        suppress_keyboard_interrupt=False,
    )
    boxes: dict[str, Group] = {}
    for title, names in AUDIENCES.items():
        boxes |= dict.fromkeys(names.split(), Group.create_ordered(title))
    groups = {
        name: App(name=name, help=text, group=boxes.get(name))
        for name, text in all_groups().items()
    }
    for name, path in all_commands(leave_out).items():
        first, dot, second = name.partition(".")
        if not dot:
            app.command(path, name=name, group=boxes.get(name))
        elif first in groups:
            groups[first].command(path, name=second)
    for group in groups.values():
        app.command(group)
    app.register_install_completion_command(help="Complete commands and options in this shell.")
    for flag in ("--help", "--version", "--install-completion"):
        app[flag].group = boxes[flag]
    return app


def in_options(error: Exception) -> str:
    """Return the option that helps, in brackets; empty if no option does."""
    option = REMEDIES.get(getattr(error, "remedy", ""))
    return f" ({option})" if option else ""


def _add_subcommands(app: App, arguments: Sequence[str], leave_out: Collection[str] = ()) -> None:
    """Register the commands under one that also runs alone: it is loaded, so only if named."""
    groups = all_groups()
    for name, path in all_commands(leave_out).items():
        first, dot, second = name.partition(".")
        if dot and first not in groups and [first] == [*arguments[:1]]:
            app[first].command(path, name=second)


def _complete_help(app: App, arguments: Sequence[str], notes: Sequence[str] = ()) -> None:
    """Load the commands of a group's help; end a help page with its example, then with notes."""
    named = app.parse_commands([word for word in arguments if word not in app.help_flags])[1][-1]
    named.resolved_commands()
    parts = [f"left out: {note}" for note in notes]
    command = named.default_command
    docstring = (inspect.getdoc(command) if command else None) or ""
    if example := re.search(r"^Examples?:\n(?:(?: {4}.*)?\n?)+", docstring, re.MULTILINE):
        parts.insert(0, example.group().strip().replace(":\n", ":\n\n", 1))
    if parts:
        named.help_epilogue = "\n\n".join(parts)


def _use_compilation_cache() -> None:
    """Tell JAX, before its import, to keep compiled programs for later processes."""
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache_root() / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("assistax-zoo")
    except PackageNotFoundError:
        return "unknown: assistax-zoo is not installed, this is a bare checkout"


def _message(error: Exception) -> str:
    first_line = printable(str(error).partition("\n")[0])
    if isinstance(error, ZooError | ValueError | TypeError):
        return printable(str(error)) + in_options(error)  # it may name what a stranger wrote
    if lacks_memory(error) or "can't start new thread" in first_line:
        limits = "this process may take no more memory, or start no more threads; see `ulimit -a`"
        return f"{limits} ({first_line[:300]})" if first_line else limits
    if isinstance(error, OSError):
        named = error.strerror and error.filename
        return printable(f"{error.strerror}: {error.filename}" if named else str(error))
    if (told := told_choice(first_line)) != first_line:
        return printable(told)
    hint = f"this is unexpected: {DEBUG_VARIABLE}=1 shows where it happened"
    return f"{type(error).__name__}: {first_line}\n{hint}"


def _fail(message: str, code: int) -> int:
    if len(message) > MOST_CHARACTERS:  # a name or a list may be of any length
        message = f"{message[: MOST_CHARACTERS // 2]} [...] {message[-MOST_CHARACTERS // 4 :]}"
    print(f"error: {message}", file=sys.stderr)
    return code


def _check_stdout() -> None:
    """Refuse a closed standard output before the work, not after it."""
    if sys.stdout is None:
        raise ValueError("standard output is closed; direct it to a file, or to /dev/null")


def _silence_stdout() -> None:
    """Point standard output at the null device, or the flush at exit would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
