"""Find the cause of a wrong answer and describe it in words, with one family of causes per module."""
