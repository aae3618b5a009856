"""Other libraries' agents as runners, here stood in for by Stable-Baselines3's own."""

import os
import sys
from types import ModuleType

import pytest

from deep_curiosity.benchmark.page import rates_table
from deep_curiosity.benchmark.peers import ADDRESSES, ENSEMBLE, installed_peers

pytest.importorskip("stable_baselines3")

from stable_baselines3 import SAC

TASK = "MountainCarContinuous-v0"


class MaxInfoSAC(SAC):
    """As MaxInfoRL's is built: the ensemble's settings first, and all others by their names."""

    def __init__(self, ensemble_model_kwargs, *args, **kwargs):
        self.ensemble_model_kwargs = ensemble_model_kwargs
        super().__init__(*args, **kwargs)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Packages of the peers' names, without a distribution."""
    for name, parts in (("sbx", []), ("maxinforl_torch", ["commons"])):
        for part in ([], *([part] for part in parts)):
            package = tmp_path.joinpath(name, *part)
            package.mkdir()
            (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    sbx, commons = ModuleType("sbx"), ModuleType("maxinforl_torch.commons")
    sbx.SAC, commons.MaxInfoSAC = SAC, MaxInfoSAC
    monkeypatch.setenv("XLA_FLAGS", "--xla_some_flag")
    return {"sbx": sbx, "maxinforl_torch.commons": commons}


def test_what_is_not_installed_is_no_peer():
    assert "MaxInfoSAC" not in " ".join(installed_peers(TASK))


def test_every_peer_that_is_installed_takes_steps(installed, monkeypatch):
    peers = installed_peers(TASK)
    assert [*peers] == [f"{label} of a clone" for label in ADDRESSES]
    for name, module in installed.items():
        monkeypatch.setitem(sys.modules, name, module)
    agents = []
    for make in peers.values():
        runner = make()
        runner.fill(300)
        runner.step(2)
        assert runner._agent._n_updates == 2
        agents.append(runner._agent)
    assert [type(agent) for agent in agents] == [SAC, MaxInfoSAC]
    assert agents[1].ensemble_model_kwargs == ENSEMBLE


def test_a_peer_is_as_wide_as_is_asked(installed, monkeypatch):
    peers = installed_peers(TASK, 16)
    for name, module in installed.items():
        monkeypatch.setitem(sys.modules, name, module)
    for make in peers.values():
        agent = make()._agent
        assert agent.actor.latent_pi[0].out_features == 16
    assert agent.ensemble_model_kwargs["features"] == (16, 16)


def test_jax_has_one_thread_and_what_the_user_set(installed, monkeypatch):
    peers = installed_peers(TASK)
    monkeypatch.setitem(sys.modules, "sbx", installed["sbx"])
    peers["SBX of a clone"]()
    flags = os.environ["XLA_FLAGS"].split()
    assert flags[0] == "--xla_some_flag" and "intra_op_parallelism_threads=1" in flags


def test_the_table_has_a_column_for_each_peer():
    rows = [
        {"runner": name, "repeat": 0, "steps_per_second": rate}
        for name, rate in (("ours", 200.0), ("Stable-Baselines3", 100.0), ("SBX 1.0", 50.0))
    ]
    memory = {"first_update_seconds": 1.0, "peak_megabytes": 300.0}
    table = rates_table(rows, {row["runner"]: memory for row in rows})
    header, _, ours = table.splitlines()[:3]
    assert "| to SBX 1.0 |" in header
    assert ours == "| ours | 200 [200, 200] | 2 [2, 2] |  | 4 [4, 4] | 1.0 | 300 |"
