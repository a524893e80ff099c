"""The learned beam for other software: simulators, robot descriptions, tables, and a stand-alone function."""
