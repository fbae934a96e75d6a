"""The command line: which commands there are, and what happens when one fails.

Commands are registered by import path, so that `assistax-zoo list` never pays for JAX, MuJoCo or
matplotlib.
"""

import contextlib
import inspect
import os
import re
import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError, Parameter

from assistax_zoo.console import remember_command
from assistax_zoo.interrupts import EXIT_INTERRUPT, end_now, ended_by_interrupts, interrupted
from zoo.errors import ZooError, printable
from zoo.locations import cache_root

DEBUG_VARIABLE = "ASSISTAX_ZOO_DEBUG"
EXIT_ERROR, EXIT_USAGE, EXIT_BROKEN_PIPE = 1, 2, 141

COMMANDS = {
    "list": "assistax_zoo.commands.zoo:list_policies",
    "show": "assistax_zoo.commands.zoo:show",
    "verify": "assistax_zoo.commands.zoo:verify",
    "fetch": "assistax_zoo.commands.remote:fetch",
    "add": "assistax_zoo.commands.remote:add",
    "remove": "assistax_zoo.commands.remote:remove",
    "publish": "assistax_zoo.commands.remote:publish",
    "lock": "assistax_zoo.commands.remote:lock",
    "export": "assistax_zoo.commands.export:export",
    "cite": "assistax_zoo.commands.cite:cite",
    "evaluate": "assistax_zoo.commands.evaluate:evaluate",
    "crossplay": "assistax_zoo.commands.evaluate:crossplay",
    "compare": "assistax_zoo.commands.report:compare",
    "strategies": "assistax_zoo.commands.report:strategies",
    "report": "assistax_zoo.commands.report:report",
    "replay": "assistax_zoo.commands.provenance:replay",
    "audit": "assistax_zoo.commands.audit:audit",
    "train": "assistax_zoo.commands.train:train",
    "train-ego": "assistax_zoo.commands.train_ego:train_ego",
    "sweep": "assistax_zoo.commands.sweep:sweep",
    "render": "assistax_zoo.commands.render:render",
    "trajectories": "assistax_zoo.commands.trajectories:trajectories",
    "doctor": "assistax_zoo.commands.doctor:doctor",
    "cache": "assistax_zoo.commands.cache:cache",
    "serve": "assistax_zoo.service.commands:serve",
    "worker": "assistax_zoo.service.commands:worker",
    "submit": "assistax_zoo.service.commands:submit",
}
GROUPS = {
    "split": (
        "Train and test halves of the partners.",
        {
            "list": "assistax_zoo.commands.split:list_splits",
            "show": "assistax_zoo.commands.split:show",
            "create": "assistax_zoo.commands.split:create",
            "verify": "assistax_zoo.commands.split:verify",
        },
    ),
    "config": (
        "Settings of this machine.",
        {"remote": "assistax_zoo.commands.remote:config_remote"},
    ),
    "plot": (
        "Figures from saved tables.",
        {
            "crossplay": "assistax_zoo.commands.plot:crossplay",
            "zsc": "assistax_zoo.commands.plot:zsc",
            "disability": "assistax_zoo.commands.plot:disability",
            "preference": "assistax_zoo.commands.plot:preference",
            "profile": "assistax_zoo.commands.plot:profile",
            "curves": "assistax_zoo.commands.plot:curves",
            "speed": "assistax_zoo.commands.plot:speed",
            "sweep": "assistax_zoo.commands.plot:sweep",
            "population": "assistax_zoo.commands.plot:population",
        },
    ),
    "token": (
        "Who may use an evaluation service.",
        {
            "create": "assistax_zoo.service.commands:token_create",
            "list": "assistax_zoo.service.commands:token_list",
            "revoke": "assistax_zoo.service.commands:token_revoke",
        },
    ),
    "season": (
        "Hidden partners of an evaluation service.",
        {
            "plan": "assistax_zoo.service.commands:season_plan",
            "create": "assistax_zoo.service.commands:season_create",
            "open": "assistax_zoo.service.commands:season_open",
            "close": "assistax_zoo.service.commands:season_close",
            "enter": "assistax_zoo.service.commands:season_enter",
            "verify": "assistax_zoo.service.commands:season_verify",
        },
    ),
    "receipt": (
        "Signed scores.",
        {"verify": "assistax_zoo.service.commands:receipt_verify"},
    ),
    "ledger": (
        "Everything that happened on an evaluation service.",
        {"verify": "assistax_zoo.service.commands:ledger_verify"},
    ),
    "service": (
        "Care of an evaluation service's data.",
        {
            "check": "assistax_zoo.service.commands:service_check",
            "backup": "assistax_zoo.service.commands:service_backup",
            "restore": "assistax_zoo.service.commands:service_restore",
            "erase": "assistax_zoo.service.commands:service_erase",
        },
    ),
}
SUBCOMMANDS = {  # of commands of their own
    "train": {"population": "assistax_zoo.commands.population:population"},
    "cache": {"clean": "assistax_zoo.commands.cache:clean_cache"},
}


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 error, 2 wrong usage, 130 interrupted.

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
        app = build_app()
        _add_subcommands(app, arguments)
        _complete_help(app, arguments)
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


def build_app() -> App:
    """Return the app with every command registered, none of them imported."""
    app = App(
        name="assistax-zoo",
        help="Pretrained partners for assistive robots, and the evaluation of robots against them.",
        version=_version,
        default_parameter=Parameter(negative_iterable=()),  # no --empty-policy beside --policy
        suppress_keyboard_interrupt=False,
    )
    for name, path in COMMANDS.items():
        app.command(path, name=name)
    for name, (text, commands) in GROUPS.items():
        group = App(name=name, help=text)
        for command, path in commands.items():
            group.command(path, name=command)
        app.command(group)
    app.register_install_completion_command(help="Complete commands and options in this shell.")
    return app


def _add_subcommands(app: App, arguments: Sequence[str]) -> None:
    """Register the commands under one that also runs alone: it is loaded, so only if named."""
    for name in SUBCOMMANDS.keys() & {*arguments[:1]}:
        for command, path in SUBCOMMANDS[name].items():
            app[name].command(path, name=command)


def _complete_help(app: App, arguments: Sequence[str]) -> None:
    """Load what a group's help lists; end a command's help with its docstring's example."""
    named = app.parse_commands([word for word in arguments if word not in app.help_flags])[1][-1]
    named.resolved_commands()
    if named.default_command is None:
        return
    docstring = inspect.getdoc(named.default_command) or ""
    if example := re.search(r"^Examples?:\n(?:(?: {4}.*)?\n?)+", docstring, re.MULTILINE):
        named.help_epilogue = example.group().strip().replace(":\n", ":\n\n", 1)


def _use_compilation_cache() -> None:
    """Tell JAX, before a command imports it, to keep what it compiles for the next process."""
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache_root() / "xla"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("assistax-zoo")
    except PackageNotFoundError:
        return "unknown: assistax-zoo is not installed, this is a bare checkout"


def _message(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror and error.filename:
        return printable(f"{error.strerror}: {error.filename}")
    if isinstance(error, ZooError | ValueError | TypeError | OSError):
        return printable(str(error))  # it may name what a stranger wrote
    if isinstance(error, MemoryError) or "can't start new thread" in str(error):
        return "this process may take no more memory, or start no more threads; see `ulimit -a`"
    first_line = printable(str(error).partition("\n")[0])
    hint = f"this is unexpected: {DEBUG_VARIABLE}=1 shows where it happened"
    return f"{type(error).__name__}: {first_line}\n{hint}"


def _fail(message: str, code: int) -> int:
    print(f"error: {message}", file=sys.stderr)
    return code


def _check_stdout() -> None:
    """Say it now, not after the work, that there is nowhere to print to."""
    if sys.stdout is None:
        raise ValueError("standard output is closed; direct it to a file, or to /dev/null")


def _silence_stdout() -> None:
    """Point standard output at nothing: the interpreter's flush on exit would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
