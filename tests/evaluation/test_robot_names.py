import re

import pytest

from evaluation.cast.robot_names import parse_reference


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("zero", ("zero", "", "", {})),
        ("random", ("random", "", "", {})),
        ("zoo:anything/*", ("zoo", "anything/*", "", {})),
        ("scratch/ippo-d1-s0-v1/robot", ("zoo", "scratch/ippo-d1-s0-v1/robot", "", {})),
        ("lab:bed_bath/ppo-*", ("zoo", "lab:bed_bath/ppo-*", "", {})),
        ("a/b.safetensors", ("file", "a/b.safetensors", "", {})),
        ("a.onnx", ("onnx", "a.onnx", "", {})),
        ("onnx:a.model", ("onnx", "a.model", "", {})),
        ("python:pkg.mod:make", ("python", "pkg.mod", "make", {})),
        ("python:x.py:make", ("python", "x.py", "make", {})),
        ("x.py", ("python", "x.py", "make", {})),
        (
            "python:/abs/x.py:make?weights=a:b.pt&size=3&note=",
            ("python", "/abs/x.py", "make", {"weights": "a:b.pt", "size": "3", "note": ""}),
        ),
    ],
)
def test_every_form_is_read(text: str, parts: tuple) -> None:
    parsed = parse_reference(text)
    assert (parsed.text, parsed.kind, parsed.source, parsed.factory, parsed.arguments) == (
        text,
        *parts,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("best", "unknown form; allowed are an id such as scratch/"),
        ("x.py:make", "did you mean python:x.py:make?"),
        ("robot.pt", "python:FILE.py:FACTORY?weights=robot.pt"),
        ("python:mod", "lacks a part"),
        ("python::make", "lacks a part"),
        ("python:mod:make()", "lacks a part"),
        ("python:mod:make?weights", "unreadable arguments"),
    ],
)
def test_unknown_reference_gets_suggestion(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_reference(text)
