"""Pictures of grooms."""
