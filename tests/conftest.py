"""One thread, random stream and precision of its own for every test, and runs of a second.

Annotations are checked at every call, with the first parameters of each test, where that does not
take more time than all else: not in `TRAINING`, nor of `deep_curiosity.tabular`, which checks its
own.
"""

import pkgutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import pytest
import torch

torch.set_num_threads(1)

package = find_spec("deep_curiosity")
assert package is not None
jaxtyping.install_import_hook(
    [
        f"deep_curiosity.{module.name}"
        for module in pkgutil.iter_modules(package.submodule_search_locations)
        if module.name != "tabular"
    ],
    "beartype.beartype",
)
jaxtyping.config.update("jaxtyping_disable", True)  # while tests are collected

from deep_curiosity.training import Config  # noqa: E402

TRAINING = [
    Path(__file__).parent / name
    for name in (
        "benchmark",
        "cli",
        "docs",
        "experiments",
        "integrations/check",
        "speed",
        "trained",
        "training",
        "test_examples.py",
        "test_readme.py",
    )
]
CHECKED = [
    Path(__file__).parent / "training" / name for name in ("test_collector.py", "test_learner.py")
]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that fork environments come first: a process with the threads of others may not."""
    forking = Path(__file__).parent / "training"
    items.sort(key=lambda item: not item.path.is_relative_to(forking))


@pytest.fixture(autouse=True)
def checked_annotations(request: pytest.FixtureRequest) -> Iterator[None]:
    """Tensors of another shape or type than annotated are refused."""
    trains = any(request.path.is_relative_to(place) for place in TRAINING)
    parameters = getattr(request.node, "callspec", None)
    repeats = parameters is not None and any(parameters.indices.values())
    checked = not repeats and (request.path in CHECKED or not trains)
    jaxtyping.config.update("jaxtyping_disable", not checked)
    yield
    jaxtyping.config.update("jaxtyping_disable", True)


@pytest.fixture(autouse=True)
def own_random_stream() -> Iterator[None]:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield


@pytest.fixture(autouse=True)
def own_precision() -> Iterator[None]:
    before = torch.get_float32_matmul_precision()
    yield
    torch.set_float32_matmul_precision(before)  # which a script that runs here may have set


@pytest.fixture(autouse=True)
def unplotted(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs leave no picture, which takes as long as the run, unless a test is marked `plotted`."""
    if "plotted" not in request.keywords:
        monkeypatch.setattr("deep_curiosity.training.figures.plot_run", lambda folder: None)


@pytest.fixture
def tiny(tiny_config: Config, tmp_path: Path) -> Config:
    return tiny_config.override(out=tmp_path / "run")


@pytest.fixture(scope="session")
def tiny_config() -> Config:
    return Config.of(
        env_id="PendulumSwingup",
        env_kwargs={"action_cost": 0.1},
        max_episode_steps=70,  # so that evaluations are short, and training is within one
        total_steps=60,
        hidden_dim=16,
        batch_size=32,
        components=16,
        num_members=2,
        refresh_interval=3,
        learning_starts=20,
        log_interval=20,
        evaluation_interval=40,
        evaluation_episodes=1,
        checkpoint_interval=25,
        replay_capacity=500,
        matmul_precision="highest",  # to compare runs, which a clock may not tell apart
    )
