"""Pictures and films of episodes: only looks, never decides anything."""
