"""From sensors to people: who is there, where they are going, and the prediction frame the policy sees."""
