"""Everything clever, each piece behind a switch; nothing else depends on it to be right."""
