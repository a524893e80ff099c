"""Tests of the core and its wings together: pages, examples, packaging, and what touches commands of both."""
