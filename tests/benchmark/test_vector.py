from deep_curiosity.benchmark.figures import plot_vector
from deep_curiosity.benchmark.run import write_page
from deep_curiosity.benchmark.vector import measure_vector_environments
from deep_curiosity.experiments.tables import write_table
from deep_curiosity_envs import TASK_IDS


def test_a_section_leaves_table_picture_and_page(tmp_path):
    rows = measure_vector_environments(TASK_IDS[:1], (1, 2), repeats=2, steps=6)
    assert len(rows) == 4
    write_table(tmp_path / "vector.csv", rows)
    plot_vector(tmp_path / "vector.png", rows)
    machine = {"section": "vector", "cpu": "some CPU", "cores": 2, "torch": "2.13"}
    write_table(
        tmp_path / "machine.csv", [machine | {"precision": "highest", "command": "make bench"}]
    )
    write_page(tmp_path)
    page = (tmp_path / "README.md").read_text()
    assert f"| {TASK_IDS[0]} | 2 | " in page
    assert "Machine: some CPU, 2 cores, torch 2.13" in page
    assert "## Agents" not in page
    assert (tmp_path / "vector.png").stat().st_size > 5_000
