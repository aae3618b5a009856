"""Many runs: tasks x agents x seeds in, one row for each run out, with statistics and figures."""
