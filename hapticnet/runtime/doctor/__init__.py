"""``hapticnet doctor``: what this machine has and lacks. Each module looks at one subject and returns findings."""
