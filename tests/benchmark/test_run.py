import pytest

from deep_curiosity.benchmark.run import check_out, write_page


def test_the_page_of_a_benchmark_may_be_written_again(tmp_path):
    check_out(tmp_path / "new")
    check_out(tmp_path)
    write_page(tmp_path)
    (tmp_path / "vector.csv").write_text("agent\n")
    check_out(tmp_path)


@pytest.mark.parametrize("name", ["README.md", "vector.csv"])
def test_files_of_something_else_are_left_alone(tmp_path, name):
    (tmp_path / name).write_text("# Mine\n")
    with pytest.raises(FileExistsError, match="`out` must name a folder without a page"):
        check_out(tmp_path)
    with pytest.raises(NotADirectoryError, match=r"got .*, which is a file"):
        check_out(tmp_path / name)
    assert (tmp_path / name).read_text() == "# Mine\n"
