import importlib.metadata

import pytest

from evaluation.play.jobs import Job
from population.environment import ToldNumbers
from population.views import View, plain_engine
from tests.evaluation.matrix_game import humans, robots

ENGINE = {"name": "native", "version": "3.3"}
# Digests of before views had a field of their own.
DIGESTS = {
    View.PLAIN: "c6728d2fcc9611bbb7e70f18ca528378851b06f75d9d86a25f3e9ca077b185df",
    View.PREFERENCE: "029a5e54cc81351d0bcd31defe2ab8ed5db185c9b0b7da391f0543e686cfcd28",
    View.NUMBERS: "4e87867151158d77b23aa1529ea93d1b33ad774c6c65bf7d44b54856fc5f2a90",
}


@pytest.mark.parametrize("view", View)
def test_job_of_a_view_keeps_its_digest(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.0")
    partners = humans(-0.5, disabilities=("d1",))
    job = Job("matrix", 1, "native", robots(0.5), partners, 2, engine=ENGINE, view=view)
    assert job.digest() == DIGESTS[view]


@pytest.mark.parametrize("view", View)
def test_view_is_read_from_its_claim(view: View) -> None:
    assert View.claimed({"task": "scratch", **view.claim}) is view
    assert plain_engine(view.engine(ENGINE)) == ENGINE


@pytest.mark.parametrize("told", ["yes", 1, None, ["partner"], {}])
def test_unknown_claim_is_the_plain_view(told: object) -> None:
    assert View.claimed({"told": told}) is View.PLAIN


def test_view_makes_the_environment_of_its_observations() -> None:
    task = "gentle_scratch"
    plain, knowing = (view.make(task, "native") for view in (View.PLAIN, View.PREFERENCE))
    numbers = View.NUMBERS.make(task, "native", numbers=[[0.0] * 25])
    assert isinstance(numbers, ToldNumbers)
    sizes = [env.observation_size["robot"] for env in (plain, knowing, numbers)]
    assert sizes[0] < sizes[1] == sizes[2] - 25
    with pytest.raises(ValueError, match="only persons have any"):
        View.NUMBERS.make(task, "native")
