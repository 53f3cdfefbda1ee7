"""What several matchers share."""
