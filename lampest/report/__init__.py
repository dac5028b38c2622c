"""What results say: tables, detections, pictures, pages."""
