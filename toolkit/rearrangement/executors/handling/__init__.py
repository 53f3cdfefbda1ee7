"""How an arm moves an object: IK and straight lines, whole ways among objects, carrying them out, and filming it."""
