"""The study of Dang et al. 2024, doi:10.1115/1.4065629: its figures, and answers to its claims."""
