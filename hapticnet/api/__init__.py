"""What ``import hapticnet`` offers. Import the names from `hapticnet` itself; docs/refer/api.md describes them."""
