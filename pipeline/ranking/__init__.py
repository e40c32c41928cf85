"""From records to a ranking: maturity classes, what reference bodies say, report entries, the last words."""
