"""From records to a ranking: maturity classes, reference bodies, report entries, closing messages."""
