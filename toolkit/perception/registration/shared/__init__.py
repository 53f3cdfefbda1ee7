"""What several registrations share."""
