"""What ``import hapticnet`` offers. Import the names from `hapticnet` itself; docs/api.md describes them."""
