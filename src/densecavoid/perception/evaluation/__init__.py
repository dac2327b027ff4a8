"""How well people are seen, followed and foreseen, measured as BENCHMARK says."""
