"""Extensions of haptid: one of each kind."""
