"""Consistency of maps: how far submaps that overlap lie apart."""
