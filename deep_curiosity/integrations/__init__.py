"""Bonuses inside the agents of other libraries; each is imported only by its own adapter."""
