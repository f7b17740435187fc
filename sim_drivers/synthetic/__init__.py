"""Recordings and motions made without a bus."""
