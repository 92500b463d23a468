"""Studies: from a file to the results of every stage, kept and resumed."""
