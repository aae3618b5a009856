"""The agent: soft actor-critic with an action prior and a second value, that of curiosity."""
