"""From records to a ranking: maturity classes, reference bodies, control chart, report entries."""
