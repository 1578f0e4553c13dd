"""Every method on the same corrupted graphs (Table IV)."""
