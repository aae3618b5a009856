import pytest

from deep_curiosity.experiments.search import ENDINGS, check_out


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_that_are_none_of_a_search_are_left_alone(tmp_path, ending):
    (tmp_path / f"mine{ending}").write_text("task,agent\n")
    with pytest.raises(FileExistsError, match=rf"`out` must name new files.*mine{ending}; choose"):
        check_out(tmp_path / "mine")
    check_out(tmp_path / "mine2")


def test_files_of_an_earlier_search_may_be_written_over(tmp_path):
    (tmp_path / "mine.csv").write_text("trial,state,score\n")
    (tmp_path / "mine.json").write_text("{}")
    check_out(tmp_path / "mine")
