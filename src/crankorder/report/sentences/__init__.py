"""What the findings say, in plain sentences: what shakes, why, how sure, what to do."""
