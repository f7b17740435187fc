"""The tree of joints, and how those without a motor follow: from MDH tables, URDFs and loops."""
