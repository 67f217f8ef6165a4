"""A folder of test runs: plan, execute, resume, publish."""
