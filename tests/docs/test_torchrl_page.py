import pytest
import torch

from tests.docs.pages import ROOT, run_blocks

PAGE = ROOT / "docs/integrations/torchrl.md"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning:torchrl")
@pytest.mark.filterwarnings("ignore:Creating .* which inherits from:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:The env passed to Collector is missing:FutureWarning")
@pytest.mark.filterwarnings("ignore:No target network updater has been associated")
def test_the_blocks_run_as_written():
    names = run_blocks(PAGE)
    stored = names["replay"].storage[:]
    assert stored["next", "reward"].max() <= 0  # Pendulum-v1 only takes: no bonus is stored
    assert len(names["replay"]) == 120
    assert torch.isfinite(names["rollout"]["next", "curiosity"]).all()
    assert int(names["learner"].every.num_calls) > 0


def test_four_lines_are_shown_and_a_fifth_for_a_value_of_its_own():
    marked = [line[-3:] for line in PAGE.read_text().splitlines() if line[-3:-1] == "# "]
    assert marked == ["# 1", "# 2", "# 3", "# 4", "# 1", "# 2", "# 3", "# 4", "# 5"]
