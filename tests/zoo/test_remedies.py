"""Libraries advise in words; the command line adds its option."""

import assistax_base.errors
from assistax_base.errors import AdvisedError, ExportError, UpdateError, ZooError
from assistax_zoo.shell.main import REMEDIES, in_options


def test_shell_adds_option_to_error_advice() -> None:
    error = ExportError("x.onnx", "no file, or the same policy", "other content")
    assert "--" not in str(error) and in_options(error) == f" ({REMEDIES['replace the file']})"
    assert in_options(UpdateError("zoo", "the old one", "changes", "ask its owner")) == ""
    assert in_options(ValueError("steps is 0")) == ""
    assert "--reuse" in in_options(AdvisedError("reuse them, or replace them", "reuse or replace"))


def test_every_remedy_has_its_words() -> None:
    # Of single errors of `zoo.transport.fetch`, the board's `rules.seasons`, results, and
    # `evaluation.play.evaluator`.
    keys = {"fetch before", "name a remote", "allow small", "evaluate first"}
    keys |= {"reuse or replace", "replace the job"}
    classes = [value for value in vars(assistax_base.errors).values() if isinstance(value, type)]
    keys |= {error.remedy for error in classes if issubclass(error, ZooError) and error.remedy}
    assert keys == set(REMEDIES)
