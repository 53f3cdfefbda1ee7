"""What a scene shows besides its objects: surfaces, a room, flat clutter, hands; drawn anew for every scene."""
