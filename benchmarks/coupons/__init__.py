"""Thirty steel coupons, each left out, beside least squares and beside quoFEM."""
