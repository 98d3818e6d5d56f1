"""Events of traffic, such as cut-ins, found in truth and in tracks by stated rules, and scores of them."""
