"""Building blocks that know nothing of curiosity: stacked networks, running statistics, Adam."""
