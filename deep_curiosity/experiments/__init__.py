"""Many runs: tasks x agents x seeds in, one row for each run out, with statistics and figures."""

from deep_curiosity.requirements import require_training

require_training()
