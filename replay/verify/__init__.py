"""Does a replay give the same bits under other circumstances? Fresh processes, and the first thing that differs."""
