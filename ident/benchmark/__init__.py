"""The public benchmark of identification: registered recordings, one judge, entries behind one interface.

`dataset` reads a data set's file, `motion` makes states of its recordings, `judge` and `forward` measure what an entry
predicts, `entries` are the methods compared, `run` judges each in a process of its own, `results` holds the figures.
"""
