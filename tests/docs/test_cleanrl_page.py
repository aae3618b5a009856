import torch

from tests.docs.pages import ROOT, run_blocks

PAGE = ROOT / "docs/integrations/cleanrl.md"


def test_the_blocks_run_as_written():
    names = run_blocks(PAGE)
    assert names["replay"].reward.max() <= 0  # Pendulum-v1 only takes: no bonus is stored
    assert names["replay"].truncated.sum() == 8
    assert torch.equal(
        names["again"].compute(names["batch"]), names["bonus"].compute(names["batch"])
    )


def test_the_five_lines_are_those_of_the_example():
    page = (line.rstrip() for line in PAGE.read_text().splitlines())
    shown = {
        line[:-3].rstrip() for line in page if line.endswith(tuple(f"# {n}" for n in "12345"))
    }
    example = (ROOT / "examples/cleanrl_sac.py").read_text().splitlines()
    marked = {line.removesuffix("# + bonus").strip() for line in example if "# + b" in line}
    assert shown == marked
