"""What somebody would do who knows everybody's whole future: futures, the quickest way, and what each place is worth.

It judges test worlds (`benchmark`) and shows policies in training what is good (`learning`). No navigator sees it.
"""
