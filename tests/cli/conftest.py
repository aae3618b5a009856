import pytest

from deep_curiosity.cli import main


@pytest.fixture
def refusal(capsys):
    """Function that gives the program a wrong command line; what it printed, on few lines."""

    def refused(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main([*map(str, arguments)])
        assert stopped.value.code == 2
        return capsys.readouterr().err

    return refused
